"""Inputs of an agent: the newest message of each, its age, and the missing ones.

An input older than `hold_cycles` is expired: the agent decides without it. Its messages name, in
`missing`, the inputs that were older than they should have been.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from itertools import chain
from typing import Any, Final

from agents.agent import Stage
from agents.plan import RunPlan
from bus_schemas.bounds import Bound, bounds_at, bounds_of, is_within
from bus_schemas.bus import Cause
from bus_schemas.errors import printable
from bus_schemas.messages import Message, Missing, Order
from bus_schemas.signals import ORDER, Occurrence, Port
from bus_schemas.tree import ROOT

log = logging.getLogger(__name__)

_NONE_YET: Final = -(2**62)

_COUNT_IN_ARMING: Final = frozenset({Cause.WRONG_SENDER, Cause.OUT_OF_RANGE})
"""The other causes do not: arming rounds overlap while links come up."""


def log_drop(count: int, why: str) -> None:
    """Log the first ten dropped messages of a kind, then the 16th, 32nd, 64th and so on."""
    if count <= 10 or count & (count - 1) == 0:
        log.warning("dropped (%d of this kind): %s", count, printable(why))


class Input:
    """One input of an agent: its newest message, and those of cycles to come.

    newest: The newest message that can be used.
    newest_cycle: Cycle of the newest message, usable or not.
    ahead: Messages of cycles to come: a child may run ahead of a parent that acts rarely.
    """

    __slots__ = ("ahead", "bounds", "incarnation", "newest", "newest_cycle", "period", "port")

    def __init__(self, port: Port[Message], period: int, bounds: tuple[Bound, ...]) -> None:
        self.port = port
        self.period = period
        self.bounds = bounds
        self.forget()

    def forget(self) -> None:
        self.newest_cycle = _NONE_YET
        self.incarnation = 0
        self.newest: Message | None = None
        self.ahead: dict[int, Message] = {}


class Inputs:
    """All inputs of an agent.

    horizon: Cycles by which a publisher may be ahead.
    on_drop: Called for each message that is not used: how many of its kind there were, and why.

    dropped: Messages that were not used, by port and cause.
    missing: Awaited inputs that had not come by a deadline.
    given_up: Inputs of agents that do not come back: no stage awaits them.
    orders: Orders since the last stage that uses them, in the order in which they came.
    """

    def __init__(
        self, plan: RunPlan, agent: str, horizon: int, on_drop: Callable[[int, str], None]
    ) -> None:
        self.of = {
            port: Input(
                port,
                plan.control.period(port),
                bounds_at(port.signal.type, plan.tree, port.node),
            )
            for port in plan.wiring.heard[agent]
            if port.signal.occurrence is not Occurrence.EVENT
        }
        self.dropped: Counter[tuple[str, str]] = Counter()
        self.missing = 0
        self.given_up: set[Port[Message]] = set()
        self.orders: list[Order] = []
        self._order_bounds = bounds_of(Order, plan.tree.rating_kw(ROOT))
        self._hold_cycles = plan.control.hold_cycles
        self._cycles = plan.timing.cycles
        self._horizon = horizon
        self._on_drop = on_drop

    def forget_before(self, cycle: int) -> None:
        """Forget all but the messages of this cycle and later ones."""
        for one in self.of.values():
            kept = {of: message for of, message in one.ahead.items() if of >= cycle}
            one.forget()
            one.ahead = kept

    def take(self, one: Input, message: Message, cycle: int) -> bool:
        """Take in a message, or refuse it and return False.

        A message of a cycle to come is kept: it may overtake the dispatch that lets an agent join.
        Before it joins, an agent keeps the newest one. A message with a bad number is not used, and
        keeps no agent waiting.
        """
        of = message.cycle
        is_usual = (
            one.newest_cycle < of == cycle < self._cycles
            and message.incarnation == one.incarnation
            and not one.ahead
            and not of % one.period
        )
        refused = None if is_usual else self._refusal(one, message, cycle)
        if refused is not None:
            cause, why = refused
            self.drop(cause, one.port, message, why, cycle)
            return False
        if of > cycle:
            if cycle < 0 and of > self._horizon:
                one.ahead.clear()
            one.ahead[of] = message
            return True
        one.newest_cycle = of
        if is_within(message, one.bounds):
            one.newest, one.incarnation = message, message.incarnation
        else:
            self.drop(Cause.OUT_OF_RANGE, one.port, message, "contains a value out of range", cycle)
        return True

    def _refusal(self, one: Input, message: Message, cycle: int) -> tuple[Cause, str] | None:
        """Return why an input refuses a message: the first reason counts, and nothing changes."""
        of, joined, newest = message.cycle, message.incarnation, one.newest_cycle
        farthest = max(cycle, 0) + self._horizon
        process = f"is of a process that joined in cycle {joined}"
        reasons = (
            (joined < one.incarnation, Cause.WRONG_SENDER, f"{process}, since replaced"),
            (0 < joined > of, Cause.OUT_OF_RANGE, f"{process}, which is yet to come"),
            (
                of >= self._cycles or (cycle >= 0 and of > farthest),
                Cause.WRONG_CYCLE,
                f"is too far from {cycle}",
            ),
            (of == newest, Cause.DUPLICATE, f"came after that of cycle {newest}"),
            (of < newest, Cause.LATE, f"came after that of cycle {newest}"),
            (of in one.ahead, Cause.DUPLICATE, "came twice"),
            (
                cycle < of <= farthest and len(one.ahead) > self._horizon,
                Cause.WRONG_CYCLE,
                "is one of too many that are ahead",
            ),
            (
                of >= 0 and of % one.period != 0,
                Cause.WRONG_CYCLE,
                "is of a cycle in which its sender does not act",
            ),
        )
        return next(((cause, why) for applies, cause, why in reasons if applies), None)

    def take_order(self, port: Port[Message], order: Order, cycle: int) -> None:
        """Take in an order, of any cycle, unless it has been long on its way."""
        if not is_within(order, self._order_bounds):
            self.drop(Cause.OUT_OF_RANGE, port, order, "contains a value out of range", cycle)
        elif order.cycle < cycle - self._hold_cycles - 1:
            self.drop(Cause.LATE, port, order, f"came in cycle {cycle}", cycle)
        else:
            self.orders.append(order)

    def go_to(self, cycle: int) -> None:
        """Take the messages that came before their cycle began."""
        for one in self.of.values():
            if one.ahead:
                for due in sorted(of for of in one.ahead if of <= cycle):
                    self.take(one, one.ahead.pop(due), cycle)

    def used(self, stage: Stage, cycle: int) -> tuple[dict[Port[Message], Any], tuple[str, ...]]:
        """Return the inputs of a stage, see `Turn.inputs`, and the `missing` of its outputs."""
        found: dict[Port[Message], Any] = {}
        missing: list[str] = []
        for port in chain(stage.awaits, stage.uses):
            if port.signal is ORDER:
                found[port] = tuple(self.orders) if cycle >= 0 else ()
                self.orders = [] if cycle >= 0 else self.orders
                continue
            one = self.of[port]
            message = one.newest
            if message is not None and message.cycle != cycle:
                # Cycles since a newer message was due.
                age = cycle - message.cycle - one.period + 1
                if age > self._hold_cycles:
                    message = None
                elif age > 0:
                    missing.append(str(Missing(str(port), message.cycle)))
            if message is None:
                missing.append(str(port))
            found[port] = message
        return found, tuple(missing)

    def drop(
        self, cause: Cause, port: Port[Message], message: Message, why: str, cycle: int
    ) -> None:
        """Count a message that is not used in a cycle of the agent."""
        if cycle >= 0 or cause in _COUNT_IN_ARMING:
            self.dropped[str(port), cause] += 1
            count = self.dropped[str(port), cause]
            self._on_drop(count, f"{port} of cycle {message.cycle} {why}")
