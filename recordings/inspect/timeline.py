"""The timeline of nodes: what each one measured, estimated, got and gave, cycle by cycle."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Final

import msgspec

from agents.request import own_request_kw
from bus_schemas.messages import (
    Command,
    Dispatch,
    Help,
    Impp,
    Message,
    Meter,
    Notice,
    Production,
    Residual,
    Setpoint,
    Telemetry,
)
from bus_schemas.signals import DISPATCH, HELP, SETPOINT, Port
from bus_schemas.tree import ROOT, agent_name, parent_of
from recordings.read.reader import RunReader

_LAG_CYCLES: Final = 1000
"""How many cycles are kept open for messages that stand further back in the file."""

_FIELDS: Final[dict[type[Message], dict[str, str]]] = {
    Telemetry: {"power_kw": "power_kw", "alpha": "applied_alpha", "available_kw": "available_kw"},
    Impp: {"power_kw": "impp_kw", "stale_cycles": "stale_cycles"},
    Residual: {"power_kw": "residual_kw"},
    Help: {"missing_kw": "help_asked_kw"},
    Setpoint: {"power_kw": "setpoint_kw", "share_kw": "share_kw"},
    Command: {"alpha": "alpha"},
    Dispatch: {
        "power_kw": "dispatch_kw",
        "commitment_kw": "commitment_kw",
        "regulation_kw": "regulation_kw",
    },
    Meter: {"power_kw": "metered_kw"},
    Production: {"possible_kw": "possible_kw", "delivered_kw": "delivered_kw"},
}
"""Which field of a message is which of the `NodeCycle` of its node."""


class HelpLine(msgspec.Struct, frozen=True):
    """Power that one node produced for another, its sibling [kW]."""

    node: str
    power_kw: float


class NodeCycle(msgspec.Struct, omit_defaults=True):
    """One node in one cycle. None, or nothing: no message said it.

    Attributes
    ----------
    cycle, time, node
        Which; local time at the beginning of the cycle.
    power_kw, applied_alpha, available_kw
        Telemetry of the interval before: what the inverter measured, the alpha that it obeyed, and
        the power that it says it could have given.
    impp_kw, stale_cycles
        Its IMPP, and for how many cycles there was no usable measurement.
    request_kw, residual_kw
        Its share of the dispatch by rating, and its IMPP less that.
    help_asked_kw
        The power that it called for.
    help_from
        Siblings that produced more than their share because it could not give its own.
    help_for
        Siblings for which it produced more than its share.
    share_kw, setpoint_kw
        Its share of its parent's target, and what it had to produce.
    alpha
        The curtailment level that it told its inverter.
    dispatch_kw, commitment_kw, regulation_kw
        Central controller: what the operator wanted, and the two parts of it.
    metered_kw
        Central controller: what the plant's meter read of the interval before.
    possible_kw, delivered_kw
        Central controller: what the plant could have given in this interval, and what it gave.
    needy
        Supervisor and central controller: children that called for help.
    moved_kw
        The same: power that its children produced for each other.
    missing
        Inputs that were not due, see `bus_schemas.missing`.
    notices
        Its notices.
    """

    cycle: int
    time: str
    node: str
    power_kw: float | None = None
    applied_alpha: float | None = None
    available_kw: float | None = None
    impp_kw: float | None = None
    stale_cycles: int = 0
    request_kw: float | None = None
    residual_kw: float | None = None
    help_asked_kw: float | None = None
    help_from: list[HelpLine] = []
    help_for: list[HelpLine] = []
    share_kw: float | None = None
    setpoint_kw: float | None = None
    alpha: float | None = None
    dispatch_kw: float | None = None
    commitment_kw: float | None = None
    regulation_kw: float | None = None
    metered_kw: float | None = None
    possible_kw: float | None = None
    delivered_kw: float | None = None
    needy: list[str] = []
    moved_kw: float | None = None
    missing: list[str] = []
    notices: list[str] = []


def timeline(run: RunReader, nodes: Collection[str], cycles: range) -> Iterator[list[NodeCycle]]:
    """Yield each cycle in order: what the recording says of some nodes in it."""
    found = _Timeline(run, nodes)
    newest = -1
    for port, message in run.on(_ports_about(run, nodes), cycles):
        if message.cycle > newest:
            newest = message.cycle
            yield from found.pop_before(newest - _LAG_CYCLES)
        found.add(port, message)
    yield from found.pop_before(cycles.stop)


def _ports_about(run: RunReader, nodes: Collection[str]) -> frozenset[Port[Message]]:
    """Return the ports that say something of some nodes, also those of siblings and children."""
    parents = {parent_of(node) for node in nodes if node != ROOT}

    def is_about(port: Port[Message]) -> bool:
        if port.node in nodes or port.signal is DISPATCH:  # Every node's request follows from it.
            return True
        parent = parent_of(port.node) if port.node != ROOT else None
        if port.signal is SETPOINT:  # Its `help_given` says for whom its power is.
            return parent in nodes or parent in parents
        return port.signal is HELP and parent in nodes

    return frozenset(filter(is_about, run.ports()))


class _Timeline:
    """Cycles that are being put together from messages."""

    def __init__(self, run: RunReader, nodes: Collection[str]) -> None:
        self._clock = run.clock
        self._tree = run.plan.tree
        self._nodes = tuple(nodes)
        self._open: dict[int, dict[str, NodeCycle]] = {}

    def add(self, port: Port[Message], message: Message) -> None:
        """Enter what a message says of its node, its sender, and the node's parent and siblings."""
        number = message.cycle
        if number not in self._open:
            time = self._clock.text(number)
            self._open[number] = {n: NodeCycle(number, time, agent_name(n)) for n in self._nodes}
        cycle = self._open[number]
        if isinstance(message, Dispatch):
            for path, node in cycle.items():
                node.request_kw = own_request_kw(message, self._tree.rating_kw(path))
        own = cycle.get(port.node)
        if own is not None:
            _enter(own, message)
        if port.node != ROOT:
            _enter_relatives(cycle, port, message)
        sender = cycle.get(ROOT if message.source == agent_name(ROOT) else message.source)
        if sender is not None:
            sender.missing = list(dict.fromkeys([*sender.missing, *message.missing]))

    def pop_before(self, cycle: int) -> Iterator[list[NodeCycle]]:
        """Yield the cycles before one of which no message is expected any more."""
        for number in sorted(number for number in self._open if number < cycle):
            yield list(self._open.pop(number).values())


def _enter(node: NodeCycle, message: Message) -> None:
    for field, name in _FIELDS.get(type(message), {}).items():
        setattr(node, name, getattr(message, field))
    if isinstance(message, Setpoint):
        node.help_for = [HelpLine(line.needy, line.power_kw) for line in message.help_given]
    elif isinstance(message, Notice):
        node.notices.append(message.text)


def _enter_relatives(cycle: dict[str, NodeCycle], port: Port[Message], message: Message) -> None:
    parent = cycle.get(parent_of(port.node))
    if isinstance(message, Help) and parent is not None:
        parent.needy.append(port.node)
    if not isinstance(message, Setpoint):
        return
    if parent is not None:
        given_kw = sum(line.power_kw for line in message.help_given)
        parent.moved_kw = (parent.moved_kw or 0.0) + given_kw
    for line in message.help_given:
        needy = cycle.get(line.needy)
        if needy is not None:
            needy.help_from.append(HelpLine(port.node, line.power_kw))
