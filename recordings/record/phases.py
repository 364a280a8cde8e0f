"""A run as the recorder follows it: arming rounds, cycles, and the end.

The plant begins the run once the recorder has heard every port in one arming round.
"""

from __future__ import annotations

from collections.abc import Collection
from math import inf
from typing import Final

from agents.plan import RunPlan
from agents.process.events import Status
from bus_schemas.messages import Dispatch, Help, Message, Production, Run
from bus_schemas.signals import Port, ports
from bus_schemas.tree import PLANT
from recordings.read.gaps import due_step

_STOP_WAIT_S: Final = 0.5
"""How long, and longer in real time, the plant may contradict a stop before the last cycle."""

_QUIET_S: Final = 0.5
_LONGEST_QUIET_S: Final = 2.0
"""How long in all the recorder waits at the end for messages that do not come: of devices, and of
processes, which say how many to expect."""

_MOST_OF_OTHERS: Final = 100_000
"""How many messages of other programs are still recorded at the end: more than a flooding device
can have waiting (some 45,000 here)."""


class ArmingRound:
    """The messages heard in the round under way. `answered`: Whether a round has been complete."""

    def __init__(self, plan: RunPlan, *, answered: bool = False) -> None:
        self.answered = answered
        self._all = frozenset(port for port in ports(plan.tree) if due_step(plan, port))
        self._cycle: int | None = None
        self._open: set[Port[Message]] = set()
        self._last: dict[Port[Message], int] = {}

    def hear(self, port: Port[Message], cycle: int) -> bool:
        """Take in a message; return whether it completes the round.

        Only the plant begins a round. A message of a later one may have overtaken the plant's.
        """
        if port.publisher == PLANT and (self._cycle is None or cycle > self._cycle):
            self._cycle = cycle
            self._open = {port for port in self._all if self._last.get(port) != cycle}
        self._last[port] = cycle
        if cycle != self._cycle or port not in self._open:
            return False
        self._open.discard(port)
        self.answered = self.answered or not self._open
        return not self._open

    def never_heard(self) -> list[str]:
        """Return the agents that have said nothing in any round."""
        return sorted({port.publisher for port in self._all - self._last.keys()})

    def unheard(self, agents: Collection[str]) -> list[str]:
        """Return the keys on which nothing of some agents came in this round."""
        return sorted(str(port) for port in self._open if port.publisher in agents)


_FOLLOWED: Final = frozenset({Dispatch, Help, Production, Run})


class RunProgress:
    """Where a run stands, by what the plant has begun, completed and said of its end.

    A stop before a cycle that the plant has begun is false: another program sent it.

    newest_cycle: Of a dispatch. completed: Number of cycles.
    stop_cycle: The first cycle that does not take place; None: it is not known.
    """

    def __init__(self, plan: RunPlan) -> None:
        self.newest_cycle = -1
        self.completed = 0
        self.stop_cycle: int | None = None
        self._plan = plan
        self._over_at_s = inf
        self._last: Production | None = None
        self._needy: dict[str, int] = {}

    @property
    def cycles(self) -> int:
        """How many cycles there are, as far as that is known."""
        return self.newest_cycle + 1 if self.stop_cycle is None else self.stop_cycle

    def hear(self, port: Port[Message], message: Message, now_s: float = 0.0) -> int | None:
        """Take in a message; return the cycle of a stop that turns out to be false."""
        if type(message) not in _FOLLOWED:  # `simulate` asks of each message.
            return None
        match message:
            case Production():
                self.completed += 1
                self._last = message
            case Help():
                self._needy[port.node] = message.cycle
            case Dispatch():
                self.newest_cycle = max(message.cycle, self.newest_cycle)
            case Run(state="stop"):
                self.stop_cycle = message.cycle
                if PLANT in self._plan.access.external:
                    wait_s = _STOP_WAIT_S + 1.5e-9 * self._plan.timing.cycle_wall_ns
                    is_early = message.cycle < self._plan.timing.cycles
                    self._over_at_s = now_s + wait_s * is_early
        false_stop = self.stop_cycle
        if false_stop is None or false_stop > self.newest_cycle:
            return None
        self.stop_cycle, self._over_at_s = None, inf
        return false_stop

    def is_newly_over(self, now_s: float) -> bool:
        """Whether an external plant's stop counts since the last call."""
        if now_s < self._over_at_s:
            return False
        self._over_at_s = inf
        return self.stop_cycle is not None

    def status(self, recorded: int) -> Status:
        """Return where the run stands; before the first cycle is over, in cycle -1."""
        last = self._last
        if last is None:
            return Status(-1, 0, 0.0, 0.0, 0.0, [], recorded)
        return Status(
            cycle=last.cycle,
            sim_time_ns=last.sim_time_ns,
            dispatch_kw=last.dispatch_kw,
            available_kw=last.available_kw,
            delivered_kw=last.delivered_kw,
            needy=sorted(node for node, cycle in self._needy.items() if cycle >= last.cycle),
            recorded=recorded,
        )


def longest_pause_s(plan: RunPlan) -> float:
    """Return how long a controller may say nothing in real time [s]."""
    return max(1.0, 2.0 * plan.timing.cycle_wall_ns / 1e9)


class Closing:
    """Waits for the last messages of a run once somebody asks for its end.

    expected: Messages of the launcher's processes; None: not known.
    """

    def __init__(self, *, has_others: bool = False) -> None:
        self._least_quiet_s = _QUIET_S if has_others else 0.0
        self.expected: int | None = None
        self._asked_at_s: float | None = None
        self._quiet_s = 0.0
        self._others_left = _MOST_OF_OTHERS

    def ask(self, now_s: float) -> None:
        if self._asked_at_s is None:
            self._asked_at_s = now_s

    def note(self, others: int, quiet_s: float) -> None:
        """Note messages from outside the launcher's processes, and a time without any message."""
        if self._asked_at_s is not None:
            self._others_left -= others
            self._quiet_s += quiet_s

    def is_over(self, now_s: float, own_heard: int) -> bool:
        """Whether the recording may end, given the messages of the launcher's processes so far."""
        if self._asked_at_s is None:
            return False
        if self.expected is None:
            return self._quiet_s > _QUIET_S or now_s > self._asked_at_s + _LONGEST_QUIET_S
        if own_heard >= self.expected and self._quiet_s >= self._least_quiet_s:
            return True
        return self._quiet_s > _LONGEST_QUIET_S or self._others_left <= 0
