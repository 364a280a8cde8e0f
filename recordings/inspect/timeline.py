"""The timeline of nodes, cycle by cycle."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import pairwise
from typing import Any, Final

import msgspec
from msgspec import UNSET

from agents.dispatch import own_share_kw
from bus_schemas import messages
from bus_schemas.messages import Dispatch, Help, Message, Notice, Setpoint
from bus_schemas.signals import DISPATCH, HELP, SETPOINT, Port
from bus_schemas.tree import CENTRAL, ROOT, ControlTree, agent_name, parent_of
from recordings.read.order_history import OrderHistory
from recordings.read.reader import RunReader
from sim_plant.orders import order_event

_LAG_CYCLES: Final = 1000
"""How many cycles are kept open for messages that stand further back in the file."""

_FIELDS: Final[dict[type[Message], dict[str, str]]] = {
    messages.Telemetry: {"power_kw": "power_kw", "energy_kwh": "stored_kwh"},
    messages.Impp: {"power_kw": "impp_kw", "stale_cycles": "stale_cycles"},
    messages.Residual: {"power_kw": "residual_kw"},
    messages.Help: {"missing_kw": "help_asked_kw"},
    messages.Setpoint: {"power_kw": "setpoint_kw"},
    messages.Command: {"alpha": "alpha"},
    messages.Dispatch: {"power_kw": "dispatch_kw", "commitment_kw": "commitment_kw"},
    messages.Meter: {"frequency_hz": "frequency_hz"},
    messages.Production: {"available_kw": "available_kw", "delivered_kw": "delivered_kw"},
}
"""Which field of a message is which value of the `NodeCycle` of its node."""


class HelpLine(msgspec.Struct, frozen=True):
    """Power that one node produced for another, its sibling [kW]."""

    node: str
    power_kw: float


class NodeCycle(msgspec.Struct):
    """One node in one cycle, at its local time.

    `values` has what messages say of the node, by the names in `_FIELDS`, and `share_kw`, its
    share of the dispatch by rating. `power_kw` is telemetry of the interval before, `stale_cycles`
    for how many cycles there was no usable measurement. Siblings produced more than their share for
    it (`help_from`), or it did so for them. Of parents: the children that called for help, and the
    power that they produced for each other.
    """

    cycle: int
    time: str
    node: str
    values: dict[str, float | None] = {}
    help_from: list[HelpLine] = []
    help_for: list[HelpLine] = []
    needy: list[str] = []
    moved_kw: float | None = None
    missing: list[str] = []
    notices: list[str] = []

    def document(self) -> dict[str, Any]:
        """Return what is known of the node as one level of names and values, for JSON."""
        always = {"cycle": self.cycle, "time": self.time, "node": self.node, **self.values}
        document = msgspec.to_builtins(self)
        more = ("help_from", "help_for", "needy", "moved_kw", "missing", "notices")
        return always | {name: document[name] for name in more if document[name]}


def timeline(run: RunReader, nodes: Collection[str], cycles: range) -> Iterator[list[NodeCycle]]:
    """Yield what the recording says of some nodes, cycle by cycle."""
    tree = run.plan.tree
    opened: dict[int, dict[str, NodeCycle]] = {}
    orders = OrderHistory()
    newest = -1
    for port, message in run.on(_ports_about(run, nodes), cycles):
        number = message.cycle
        if number > newest:
            newest = number
            yield from _pop_before(newest - _LAG_CYCLES, opened, orders)
        if number not in opened:
            time = run.clock.text(number)
            opened[number] = {node: NodeCycle(number, time, agent_name(node)) for node in nodes}
        _add(opened[number], tree, port, message)
        if isinstance(message, Dispatch):
            orders.see(message)
    yield from _pop_before(cycles.stop, opened, orders)


def _ports_about(run: RunReader, nodes: Collection[str]) -> frozenset[Port[Message]]:
    """Return the ports with messages about some nodes, including those of siblings and children."""
    parents = {parent_of(node) for node in nodes if node != ROOT}

    def is_about(port: Port[Message]) -> bool:
        if port.node in nodes or port.signal is DISPATCH:  # Every node's share follows from it.
            return True
        parent = parent_of(port.node) if port.node != ROOT else None
        if port.signal is SETPOINT:  # Its `help_given` names the siblings that get its power.
            return parent in nodes or parent in parents
        return port.signal is HELP and parent in nodes

    return frozenset(filter(is_about, run.ports()))


def _add(
    cycle: dict[str, NodeCycle], tree: ControlTree, port: Port[Message], message: Message
) -> None:
    """Enter a message at its node, its sender, and the node's parent and siblings."""
    own = cycle.get(port.node)
    parent = None if port.node == ROOT else cycle.get(parent_of(port.node))
    sender = cycle.get(ROOT if message.source == CENTRAL else message.source)
    if own is not None:
        for field, name in _FIELDS.get(type(message), {}).items():
            if (value := getattr(message, field)) is not UNSET:
                own.values[name] = value
    if sender is not None:
        sender.missing = list(dict.fromkeys([*sender.missing, *message.missing]))
    match message:
        case Dispatch():
            for path, node in cycle.items():
                node.values["share_kw"] = own_share_kw(message, tree.sharing_kw(path))
        case Help() if parent is not None:
            parent.needy.append(port.node)
        case Notice() if own is not None:
            own.notices.append(message.text)
        case Setpoint():
            _add_help(cycle, port.node, message)


def _add_help(cycle: dict[str, NodeCycle], node: str, setpoint: Setpoint) -> None:
    given = [HelpLine(line.needy, line.power_kw) for line in setpoint.help_given]
    if node in cycle:
        cycle[node].help_for = given
    parent = cycle.get(parent_of(node))
    if parent is not None:
        parent.moved_kw = (parent.moved_kw or 0.0) + sum(line.power_kw for line in given)
    for line in given:
        if line.node in cycle:
            cycle[line.node].help_from.append(HelpLine(node, line.power_kw))


def _pop_before(
    cycle: int, opened: dict[int, dict[str, NodeCycle]], orders: OrderHistory
) -> Iterator[list[NodeCycle]]:
    """Yield the opened cycles before one: no message of them will follow."""
    due = sorted(number for number in opened if number < cycle)
    if due:
        for last, dispatch in pairwise([None, *orders.changes()]):
            node = opened.get(dispatch.cycle, {}).get(ROOT) if dispatch else None
            if (
                dispatch
                and node
                and dispatch.cycle < cycle
                and (event := order_event(dispatch, last))
            ):
                node.notices.append(" ".join(event))
    for number in due:
        yield list(opened.pop(number).values())
