"""The timeline of nodes: what each one measured, estimated, got and gave, cycle by cycle."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Final, NamedTuple

import msgspec
from msgspec.structs import replace

from agents.dispatch import own_request_kw
from bus_schemas import messages
from bus_schemas.messages import Dispatch, Help, Message, Notice, Setpoint
from bus_schemas.missing import in_words
from bus_schemas.signals import DISPATCH, HELP, SETPOINT, Port
from bus_schemas.tree import CENTRAL, ROOT, ControlTree, agent_name, parent_of
from recordings.read.reader import RunReader

_LAG_CYCLES: Final = 1000
"""How many cycles are kept open for messages that stand further back in the file."""

_FIELDS: Final[dict[type[Message], dict[str, str]]] = {
    messages.Telemetry: {"power_kw": "power_kw"},
    messages.Impp: {"power_kw": "impp_kw", "stale_cycles": "stale_cycles"},
    messages.Residual: {"power_kw": "residual_kw"},
    messages.Help: {"missing_kw": "help_asked_kw"},
    messages.Setpoint: {"power_kw": "setpoint_kw"},
    messages.Command: {"alpha": "alpha"},
    messages.Dispatch: {"power_kw": "dispatch_kw", "commitment_kw": "commitment_kw"},
    messages.Production: {"possible_kw": "possible_kw", "delivered_kw": "delivered_kw"},
}
"""Which field of a message is which of the `NodeCycle` of its node."""


class HelpLine(msgspec.Struct, frozen=True):
    """Power that one node produced for another, its sibling [kW]."""

    node: str
    power_kw: float


class NodeCycle(msgspec.Struct, omit_defaults=True):
    """One node in one cycle, at its local time. None, or nothing: no message said it.

    `power_kw` is telemetry of the interval before, `stale_cycles` for how many cycles there was no
    usable measurement, `request_kw` the share of the dispatch by rating. Siblings produced more
    than their share for it (`help_from`), or it did so for them. Of parents: the children that
    called for help, and the power that they produced for each other.
    """

    cycle: int
    time: str
    node: str
    power_kw: float | None = None
    impp_kw: float | None = None
    stale_cycles: int = 0
    request_kw: float | None = None
    residual_kw: float | None = None
    help_asked_kw: float | None = None
    help_from: list[HelpLine] = []
    help_for: list[HelpLine] = []
    setpoint_kw: float | None = None
    alpha: float | None = None
    dispatch_kw: float | None = None
    commitment_kw: float | None = None
    possible_kw: float | None = None
    delivered_kw: float | None = None
    needy: list[str] = []
    moved_kw: float | None = None
    missing: list[str] = []
    notices: list[str] = []


def timeline(run: RunReader, nodes: Collection[str], cycles: range) -> Iterator[list[NodeCycle]]:
    """Yield each cycle in order: what the recording says of some nodes in it."""
    tree = run.plan.tree
    opened: dict[int, dict[str, NodeCycle]] = {}
    newest = -1
    for port, message in run.on(_ports_about(run, nodes), cycles):
        number = message.cycle
        if number > newest:
            newest = number
            yield from _pop_before(newest - _LAG_CYCLES, opened)
        if number not in opened:
            time = run.clock.text(number)
            opened[number] = {node: NodeCycle(number, time, agent_name(node)) for node in nodes}
        _add(opened[number], tree, port, message)
    yield from _pop_before(cycles.stop, opened)


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


def _add(
    cycle: dict[str, NodeCycle], tree: ControlTree, port: Port[Message], message: Message
) -> None:
    """Enter what a message says of its node, its sender, and the node's parent and siblings."""
    own = cycle.get(port.node)
    parent = None if port.node == ROOT else cycle.get(parent_of(port.node))
    sender = cycle.get(ROOT if message.source == CENTRAL else message.source)
    if own is not None:
        for field, name in _FIELDS.get(type(message), {}).items():
            setattr(own, name, getattr(message, field))
    if sender is not None:
        sender.missing = list(dict.fromkeys([*sender.missing, *message.missing]))
    match message:
        case Dispatch():
            for path, node in cycle.items():
                node.request_kw = own_request_kw(message, tree.rating_kw(path))
        case Help() if parent is not None:
            parent.needy.append(port.node)
        case Notice() if own is not None:
            own.notices.append(message.text)
        case Setpoint():
            _add_help(cycle, port.node, message)


def _add_help(cycle: dict[str, NodeCycle], node: str, setpoint: Setpoint) -> None:
    """Enter which siblings a node helped, and by how much."""
    given = [HelpLine(line.needy, line.power_kw) for line in setpoint.help_given]
    if node in cycle:
        cycle[node].help_for = given
    parent = cycle.get(parent_of(node))
    if parent is not None:
        parent.moved_kw = (parent.moved_kw or 0.0) + sum(line.power_kw for line in given)
    for line in given:
        if line.node in cycle:
            cycle[line.node].help_from.append(HelpLine(node, line.power_kw))


def _pop_before(cycle: int, opened: dict[int, dict[str, NodeCycle]]) -> Iterator[list[NodeCycle]]:
    """Yield the cycles before one of which no message is expected any more."""
    for number in sorted(number for number in opened if number < cycle):
        yield list(opened.pop(number).values())


# As text, in columns of fixed width ---------------------------------------------------------------


class Column(NamedTuple):
    """One column: its heading, the field that it shows, its width and format."""

    name: str
    field: str
    width: int = 8
    form: str = ".2f"

    def text(self, node: NodeCycle) -> str:
        value = getattr(node, self.field)
        return ("-" if value is None else format(value, self.form)).rjust(self.width)


_IMPP: Final = Column("IMPP", "impp_kw")
_RESIDUAL: Final = Column("residual", "residual_kw")
_REQUEST: Final = Column("request", "request_kw")
_ASKED: Final = Column("asked", "help_asked_kw")
_SETPOINT: Final = Column("setpoint", "setpoint_kw")

_DIRECT: Final = (
    Column("power", "power_kw"),
    *(_IMPP, _REQUEST, _RESIDUAL, _ASKED, _SETPOINT),
    Column("alpha", "alpha", 6, ".4f"),
)
_SUPERVISOR: Final = (_IMPP, _REQUEST, _RESIDUAL, _ASKED, _SETPOINT, Column("moved", "moved_kw"))
_CENTRAL: Final = (
    Column("dispatch", "dispatch_kw"),
    *(_IMPP, _RESIDUAL, _ASKED),
    Column("possible", "possible_kw"),
    Column("produced", "delivered_kw"),
)


def node_columns(tree: ControlTree, node: str, time_width: int) -> tuple[Column, ...]:
    """Return the columns of one node's timeline."""
    powers = _CENTRAL if node == ROOT else _DIRECT if tree.is_leaf(node) else _SUPERVISOR
    return (Column("cycle", "cycle", 6, "d"), Column("time", "time", time_width, ""), *powers)


def heading(columns: Sequence[Column]) -> str:
    """Return the line above the columns."""
    names = " ".join(column.name.rjust(column.width) for column in columns)
    return f"{names}  help, remarks [kW]"


def row_text(columns: Sequence[Column], node: NodeCycle) -> str:
    """Return a node in one cycle: its columns, and its remarks, however long they are."""
    cells = " ".join(column.text(node) for column in columns)
    return f"{cells}  {_remarks(node)}".rstrip()


def plant_lines(tree: ControlTree, nodes: Sequence[NodeCycle]) -> Iterator[str]:
    """Yield the plant in one cycle: a heading, and its nodes as a tree."""
    branches = dict(_branches(tree, ROOT, ""))
    longest = max(map(len, branches.values()))
    columns = (Column("node".ljust(longest), "node", longest, f"<{longest}"), *_DIRECT)
    yield heading(columns)
    by_path = dict(zip(tree.nodes, nodes, strict=True))
    for path, branch in branches.items():
        yield row_text(columns, replace(by_path[path], node=branch))


def _branches(tree: ControlTree, node: str, indent: str) -> Iterator[tuple[str, str]]:
    """Yield each node with the branch that it is drawn at."""
    if node == ROOT:
        yield node, agent_name(node)
    children = tree.children(node)
    for child in children:
        last = child == children[-1]
        yield child, f"{indent}{'└─' if last else '├─'} {child.rpartition('/')[2]}"
        yield from _branches(tree, child, indent + ("   " if last else "│  "))


def _remarks(node: NodeCycle) -> str:
    """Return what has no column: who gave help to whom, missing inputs, notices."""
    said = [
        _help_text("from", node.help_from),
        _help_text("for", node.help_for),
        f"moved {node.moved_kw:.2f}" if node.node == CENTRAL and node.moved_kw else "",
        "need: " + ", ".join(map(_short, node.needy)) if node.needy else "",
        f"stale for {node.stale_cycles}" if node.stale_cycles else "",
        in_words(node.missing),
        *node.notices,
    ]
    return "; ".join(part for part in said if part)


def _help_text(word: str, lines: Sequence[HelpLine]) -> str:
    given = ", ".join(f"{_short(line.node)} {line.power_kw:.2f}" for line in lines)
    return f"{word} {given}" if given else ""


def _short(path: str) -> str:
    """Return the last part of a path: help is given among siblings."""
    return path.rpartition("/")[2]
