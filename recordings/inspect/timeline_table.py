"""One node cycle by cycle, and the plant in one cycle as a tree, in columns of fixed width."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from bus_schemas.missing import in_words
from bus_schemas.tree import CENTRAL, ROOT, ControlTree, agent_name
from recordings.inspect.timeline import HelpLine, NodeCycle

NARROWEST: Final = 80
"""The tables are whole from this width on [characters]."""

_GAP: Final = "  "
_LEAST_REMARK: Final = 20
"""Remarks stand beside the columns if there is so much room, otherwise below them."""

_INDENT: Final = 16

_POWER_WIDTH: Final = 8
_NOTHING: Final = "-"


@dataclass(frozen=True, slots=True)
class Column:
    """One column: its two lines of heading, its width, and the text of a cell."""

    name: str
    unit: str
    width: int
    text: Callable[[NodeCycle], str]


def _power(name: str, field: str, unit: str = "kW") -> Column:
    def text(node: NodeCycle) -> str:
        value: float | None = getattr(node, field)
        return _NOTHING if value is None else f"{value:.2f}"

    return Column(name, unit, _POWER_WIDTH, text)


def _alpha(node: NodeCycle) -> str:
    return _NOTHING if node.alpha is None else f"{node.alpha:.4f}"


_IMPP: Final = _power("IMPP", "impp_kw")
_REQUEST: Final = _power("request", "request_kw")
_RESIDUAL: Final = _power("residual", "residual_kw")
_HELP_ASKED: Final = _power("help", "help_asked_kw", "asked kW")
_SETPOINT: Final = _power("setpoint", "setpoint_kw")
_POWER: Final = _power("power", "power_kw")
_MOVED: Final = _power("moved", "moved_kw")
_ALPHA: Final = Column("alpha", "", 6, _alpha)

_DIRECT: Final = (_POWER, _IMPP, _REQUEST, _RESIDUAL, _HELP_ASKED, _SETPOINT, _ALPHA)
_SUPERVISOR: Final = (_REQUEST, _IMPP, _RESIDUAL, _HELP_ASKED, _SETPOINT, _MOVED)
_CENTRAL: Final = (
    _power("dispatch", "dispatch_kw"),
    _IMPP,
    _RESIDUAL,
    _HELP_ASKED,
    _power("possible", "possible_kw"),
    _power("produced", "delivered_kw"),
)


class TimelineTable:
    """The lines of one node's timeline."""

    def __init__(
        self, tree: ControlTree, node: str, time_width: int, width: int = NARROWEST
    ) -> None:
        powers: tuple[Column, ...]
        if node == ROOT:
            powers, last = _CENTRAL, ("children in need", "")
        elif tree.is_leaf(node):
            powers, last = _DIRECT, ("help given", "from or for whom, kW")
        else:
            powers, last = _SUPERVISOR, ("help given, children in need", "from or for whom, kW")
        self._columns = (
            Column("cycle", "", 6, lambda row: str(row.cycle)),
            Column("time", "local", time_width, lambda row: row.time),
            *powers,
        )
        self._last = last
        self._width = width

    def heading(self) -> list[str]:
        """Return the two lines above the columns."""
        return _heading(self._columns, self._last, self._width)

    def row(self, node: NodeCycle) -> list[str]:
        """Return the lines of one cycle: its columns, and its remarks."""
        cells = " ".join(column.text(node).rjust(column.width) for column in self._columns)
        return _with_remarks(cells, _remarks(node), self._width)


def plant_lines(
    tree: ControlTree, nodes: Sequence[NodeCycle], width: int = NARROWEST
) -> Iterator[str]:
    """Yield the plant in one cycle: its nodes as a tree, with the columns of a timeline."""
    by_path = {_path(node): node for node in nodes}
    branches = dict(_branches(tree, ROOT, ""))
    longest = max(len(branch) for branch in branches.values())
    node_column = Column("node".ljust(longest), "", longest, lambda row: branches[_path(row)])
    columns = (node_column, *_DIRECT)
    yield from _heading(columns, ("help given", "from or for whom, kW"), width)
    for path, branch in branches.items():
        node = by_path[path]
        cells = " ".join(
            [branch.ljust(longest)] + [column.text(node).rjust(column.width) for column in _DIRECT]
        )
        yield from _with_remarks(cells, _remarks(node), width)


def _branches(tree: ControlTree, node: str, indent: str) -> Iterator[tuple[str, str]]:
    """Yield each node with the branch that it is drawn at."""
    if node == ROOT:
        yield node, agent_name(node)
    children = tree.children(node)
    for child in children:
        last = child == children[-1]
        yield child, f"{indent}{'└─' if last else '├─'} {child.rpartition('/')[2]}"
        yield from _branches(tree, child, indent + ("   " if last else "│  "))


def _heading(columns: Sequence[Column], last: tuple[str, str], width: int) -> list[str]:
    names = " ".join(column.name.rjust(column.width) for column in columns)
    units = " ".join(column.unit.rjust(column.width) for column in columns)
    if width - len(names) - len(_GAP) < _LEAST_REMARK:
        return [names.rstrip(), units.rstrip()]
    return [f"{names}{_GAP}{last[0]}".rstrip(), f"{units}{_GAP}{last[1]}".rstrip()]


def _with_remarks(cells: str, remarks: str, width: int) -> list[str]:
    begin = len(cells) + len(_GAP)
    if width - begin < _LEAST_REMARK:
        lines = textwrap.wrap(remarks, width - _INDENT)
        return [cells.rstrip(), *(" " * _INDENT + line for line in lines)]
    first, *rest = textwrap.wrap(remarks, width - begin) or [""]
    return [f"{cells}{_GAP}{first}".rstrip(), *(" " * begin + line for line in rest)]


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


def _path(node: NodeCycle) -> str:
    return ROOT if node.node == agent_name(ROOT) else node.node
