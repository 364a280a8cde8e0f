"""What each node measured, estimated, got and gave, cycle by cycle."""

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
from bus_schemas.tree import ROOT, ControlTree, agent_name, parent_of
from recordings.read.reader import RunReader

_LAG_CYCLES: Final = 1000
"""How many cycles are kept open for messages that stand further back in the file."""


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
        What it said in words.
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


def story(run: RunReader, nodes: Collection[str], cycles: range) -> Iterator[list[NodeCycle]]:
    """Tell what happened to some nodes, cycle by cycle."""
    teller = _Teller(run, nodes)
    front = -1
    for port, message in run.on(_ports_about(run, nodes), cycles):
        if message.cycle > front:
            front = message.cycle
            yield from teller.tell_before(front - _LAG_CYCLES)
        teller.see(port, message)
    yield from teller.tell_before(cycles.stop)


def _ports_about(run: RunReader, nodes: Collection[str]) -> frozenset[Port[Message]]:
    """Return the ports that tell of some nodes, with those of siblings and children that do."""
    parents = {parent_of(node) for node in nodes if node != ROOT}

    def tells(port: Port[Message]) -> bool:
        if port.node in nodes or port.signal is DISPATCH:  # Every node's request follows from it.
            return True
        parent = parent_of(port.node) if port.node != ROOT else None
        if port.signal is SETPOINT:  # A setpoint's account says for whom its power is.
            return parent in nodes or parent in parents
        return port.signal is HELP and parent in nodes

    return frozenset(port for port in run.ports() if tells(port))


class _Teller:
    """Puts what is said of nodes into their cycles."""

    def __init__(self, run: RunReader, nodes: Collection[str]) -> None:
        self._clock = run.clock
        self._tree: ControlTree = run.plan.tree
        self._nodes = tuple(nodes)
        self._open: dict[int, dict[str, NodeCycle]] = {}

    def see(self, port: Port[Message], message: Message) -> None:
        """Take in a message."""
        cycle = self._open.get(message.cycle)
        if cycle is None:
            cycle = self._open[message.cycle] = self._begin(message.cycle)
        if isinstance(message, Dispatch):
            self._tell_requests(cycle, message)
        own = cycle.get(port.node)
        if own is not None:
            _tell_of(own, message)
        if port.node != ROOT:
            self._tell_relatives(cycle, port, message)
        sender = cycle.get(ROOT if message.source == agent_name(ROOT) else message.source)
        if sender is not None:
            sender.missing = list(dict.fromkeys([*sender.missing, *message.missing]))

    def tell_before(self, cycle: int) -> Iterator[list[NodeCycle]]:
        """Yield the cycles before one of which no message is expected any more."""
        for number in sorted(number for number in self._open if number < cycle):
            yield list(self._open.pop(number).values())

    def _begin(self, cycle: int) -> dict[str, NodeCycle]:
        time = self._clock.text(cycle)
        return {node: NodeCycle(cycle, time, agent_name(node)) for node in self._nodes}

    def _tell_requests(self, cycle: dict[str, NodeCycle], dispatch: Dispatch) -> None:
        for path, node in cycle.items():
            node.request_kw = own_request_kw(dispatch, self._tree.rating_kw(path))

    def _tell_relatives(
        self, cycle: dict[str, NodeCycle], port: Port[Message], message: Message
    ) -> None:
        """Tell a node's parent and siblings what its call for help or its setpoint says of them."""
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


def _tell_of(node: NodeCycle, message: Message) -> None:
    """Enter what a message says of the node that it is about."""
    match message:
        case Telemetry():
            node.power_kw, node.applied_alpha = message.power_kw, message.alpha
            node.available_kw = message.available_kw
        case Impp():
            node.impp_kw, node.stale_cycles = message.power_kw, message.stale_cycles
        case Residual():
            node.residual_kw = message.power_kw
        case Help():
            node.help_asked_kw = message.missing_kw
        case Setpoint():
            node.setpoint_kw, node.share_kw = message.power_kw, message.share_kw
            node.help_for = [HelpLine(line.needy, line.power_kw) for line in message.help_given]
        case Command():
            node.alpha = message.alpha
        case _:
            _tell_of_plant(node, message)


def _tell_of_plant(node: NodeCycle, message: Message) -> None:
    match message:
        case Dispatch():
            node.dispatch_kw = message.power_kw
            node.commitment_kw = message.commitment_kw
            node.regulation_kw = message.regulation_kw
        case Meter():
            node.metered_kw = message.power_kw
        case Production():
            node.possible_kw, node.delivered_kw = message.possible_kw, message.delivered_kw
        case Notice():
            node.notices.append(message.text)
