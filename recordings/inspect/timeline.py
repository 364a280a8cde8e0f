"""The timeline of nodes: what each one measured, estimated, got and gave, cycle by cycle."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

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
    messages.Telemetry: {
        "power_kw": "power_kw",
        "alpha": "applied_alpha",
        "available_kw": "available_kw",
    },
    messages.Impp: {"power_kw": "impp_kw", "stale_cycles": "stale_cycles"},
    messages.Residual: {"power_kw": "residual_kw"},
    messages.Help: {"missing_kw": "help_asked_kw"},
    messages.Setpoint: {"power_kw": "setpoint_kw", "share_kw": "share_kw"},
    messages.Command: {"alpha": "alpha"},
    messages.Dispatch: {
        "power_kw": "dispatch_kw",
        "commitment_kw": "commitment_kw",
        "regulation_kw": "regulation_kw",
    },
    messages.Meter: {"power_kw": "metered_kw"},
    messages.Production: {"possible_kw": "possible_kw", "delivered_kw": "delivered_kw"},
}
"""Which field of a message is which of the `NodeCycle` of its node."""


class HelpLine(msgspec.Struct, frozen=True):
    """Power that one node produced for another, its sibling [kW]."""

    node: str
    power_kw: float


class NodeCycle(msgspec.Struct, omit_defaults=True):
    """One node in one cycle, at its local time. None, or nothing: no message said it.

    `power_kw`, `applied_alpha` and `available_kw` are telemetry of the interval before. Then come
    its IMPP, and for how many cycles there was no usable measurement; its share of the dispatch by
    rating, and its IMPP less that; the power that it called for; siblings that produced more than
    their share for it, or for which it did; its share of its parent's target, and what it had to
    produce; the curtailment level that it told its inverter.

    Of the central controller: the dispatch and its two parts, the plant's meter of the interval
    before, and what the plant could have given and gave in this one. Of parents: the children that
    called for help, and the power that they produced for each other.
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

NARROWEST: Final = 80
"""The tables are whole from this width on [characters]."""

_GAP: Final = "  "
_LEAST_REMARK: Final = 20
"""Remarks stand beside the columns if there is so much room, otherwise below them."""

_INDENT: Final = 16


@dataclass(frozen=True, slots=True)
class Column:
    """One column: its two lines of heading, the field that it shows, its width and format."""

    name: str
    unit: str
    field: str
    width: int = 8
    form: str = ".2f"

    def text(self, node: NodeCycle) -> str:
        value = getattr(node, self.field)
        return ("-" if value is None else format(value, self.form)).rjust(self.width)


_IMPP: Final = Column("IMPP", "kW", "impp_kw")
_REQUEST: Final = Column("request", "kW", "request_kw")
_RESIDUAL: Final = Column("residual", "kW", "residual_kw")
_HELP_ASKED: Final = Column("help", "asked kW", "help_asked_kw")
_SETPOINT: Final = Column("setpoint", "kW", "setpoint_kw")
_POWER: Final = Column("power", "kW", "power_kw")
_MOVED: Final = Column("moved", "kW", "moved_kw")
_ALPHA: Final = Column("alpha", "", "alpha", 6, ".4f")

_DIRECT: Final = (_POWER, _IMPP, _REQUEST, _RESIDUAL, _HELP_ASKED, _SETPOINT, _ALPHA)
_SUPERVISOR: Final = (_REQUEST, _IMPP, _RESIDUAL, _HELP_ASKED, _SETPOINT, _MOVED)
_CENTRAL: Final = (
    Column("dispatch", "kW", "dispatch_kw"),
    *(_IMPP, _RESIDUAL, _HELP_ASKED),
    Column("possible", "kW", "possible_kw"),
    Column("produced", "kW", "delivered_kw"),
)


_HELP_GIVEN: Final = ("help given", "from or for whom, kW")


@dataclass(frozen=True, slots=True)
class TimelineTable:
    """Lines of nodes in columns; `last` is the heading above their remarks, in two lines."""

    columns: tuple[Column, ...]
    last: tuple[str, str]
    width: int

    def heading(self) -> list[str]:
        """Return the two lines above the columns."""
        names = " ".join(column.name.rjust(column.width) for column in self.columns)
        units = " ".join(column.unit.rjust(column.width) for column in self.columns)
        if self.width - len(names) - len(_GAP) < _LEAST_REMARK:
            return [names.rstrip(), units.rstrip()]
        return [f"{names}{_GAP}{self.last[0]}".rstrip(), f"{units}{_GAP}{self.last[1]}".rstrip()]

    def row(self, node: NodeCycle) -> list[str]:
        """Return the lines of a node in one cycle: its columns, and its remarks."""
        cells, remarks = " ".join(column.text(node) for column in self.columns), _remarks(node)
        begin = len(cells) + len(_GAP)
        if self.width - begin < _LEAST_REMARK:
            lines = textwrap.wrap(remarks, self.width - _INDENT)
            return [cells.rstrip(), *(" " * _INDENT + line for line in lines)]
        first, *rest = textwrap.wrap(remarks, self.width - begin) or [""]
        return [f"{cells}{_GAP}{first}".rstrip(), *(" " * begin + line for line in rest)]


def node_table(
    tree: ControlTree, node: str, time_width: int, width: int = NARROWEST
) -> TimelineTable:
    """Return the table of one node's timeline."""
    powers: tuple[Column, ...]
    if node == ROOT:
        powers, last = _CENTRAL, ("children in need", "")
    elif tree.is_leaf(node):
        powers, last = _DIRECT, _HELP_GIVEN
    else:
        powers, last = _SUPERVISOR, ("help given, children in need", "from or for whom, kW")
    when = Column("cycle", "", "cycle", 6, "d"), Column("time", "local", "time", time_width, "")
    return TimelineTable((*when, *powers), last, width)


def plant_lines(
    tree: ControlTree, nodes: Sequence[NodeCycle], width: int = NARROWEST
) -> Iterator[str]:
    """Yield the plant in one cycle: its nodes as a tree, with the columns of a timeline."""
    branches = dict(_branches(tree, ROOT, ""))
    longest = max(len(branch) for branch in branches.values())
    first = Column("node".ljust(longest), "", "node", longest, f"<{longest}")
    table = TimelineTable((first, *_DIRECT), _HELP_GIVEN, width)
    yield from table.heading()
    by_path = dict(zip(tree.nodes, nodes, strict=True))
    for path, branch in branches.items():
        yield from table.row(replace(by_path[path], node=branch))


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
