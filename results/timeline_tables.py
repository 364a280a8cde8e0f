"""The timeline of a recording as tables: one node cycle by cycle, or the plant in one cycle."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from bus_schemas.messages import in_words
from bus_schemas.tree import CENTRAL, ROOT, ControlTree, agent_name
from recordings.inspect.agent_states import AgentState
from recordings.inspect.timeline import HelpLine, NodeCycle
from results.tables import Cell, Column, Table, counted, key_column, word_column

_CYCLE: Final = Column("cycle", key=True)


def _powers(**names: str) -> tuple[Column, ...]:
    return tuple(Column(title, decimals=1, name=name) for title, name in names.items())


_SHARED: Final = _powers(
    IMPP="impp_kw",
    share="share_kw",
    residual="residual_kw",
    asked="help_asked_kw",
    setpoint="setpoint_kw",
)
_DIRECT: Final = (*_powers(power="power_kw"), *_SHARED, Column("alpha", decimals=4))
_SUPERVISOR: Final = (*_SHARED, *_powers(moved="moved_kw"))
_CENTRAL: Final = _powers(
    dispatch="dispatch_kw",
    IMPP="impp_kw",
    residual="residual_kw",
    asked="help_asked_kw",
    available="available_kw",
    produced="delivered_kw",
)
_REMARKS: Final = word_column("help [kW], remarks", "remarks")


def node_table(tree: ControlTree, node: str, rows: Sequence[NodeCycle]) -> Table:
    """Return one node, cycle by cycle."""
    powers = _CENTRAL if node == ROOT else _DIRECT if tree.is_leaf(node) else _SUPERVISOR
    columns = (_CYCLE, key_column("time"), *powers, _REMARKS)
    cells = [(str(row.cycle), row.time, *_cells(powers, row), _remarks(row)) for row in rows]
    return Table(agent_name(node), columns, cells)


def plant_table(tree: ControlTree, title: str, nodes: Sequence[NodeCycle]) -> Table:
    """Return all nodes of the plant in one cycle, as a tree."""
    of_path = dict(zip(tree.nodes, nodes, strict=True))
    cells = [
        (branch, *_cells(_DIRECT, of_path[path]), _remarks(of_path[path]))
        for path, branch in _branches(tree, ROOT, "")
    ]
    return Table(title, (key_column("node"), *_DIRECT, _REMARKS), cells)


def states_table(states: Mapping[str, AgentState]) -> Table:
    """Return the agents of which there is something to say, by what led to a cycle."""
    shown = {
        agent: state
        for agent, state in states.items()
        if state.kind != "fine" or state.missed_inputs or state.restarts
    }
    columns = (
        key_column("agent"),
        word_column("state"),
        Column("inputs missed", name="missed_inputs"),
        Column("restarts"),
    )
    rows = [
        (agent, state.text(), state.missed_inputs, state.restarts) for agent, state in shown.items()
    ]
    others = len(states) - len(shown)
    note = f"{counted(others, 'agent')} fine, without missed inputs or restarts" if others else ""
    return Table("Agents up to this cycle", columns, rows, (note,) if note else ())


def _cells(columns: Sequence[Column], row: NodeCycle) -> Iterator[Cell]:
    values = {**row.values, "moved_kw": row.moved_kw}
    return (values.get(column.name or column.title) for column in columns)


def _branches(tree: ControlTree, node: str, indent: str) -> Iterator[tuple[str, str]]:
    """Yield each node with the branch that it is drawn at."""
    if node == ROOT:
        yield node, agent_name(node)
    children = tree.children(node)
    for child in children:
        last = child == children[-1]
        yield child, f"{indent}{'└─' if last else '├─'} {_short(child)}"
        yield from _branches(tree, child, indent + ("   " if last else "│  "))


def _remarks(row: NodeCycle) -> str:
    """Return what has no column: who gave help to whom, missing inputs, notices."""
    stale, stored_kwh = row.values.get("stale_cycles"), row.values.get("stored_kwh")
    parts = [
        _help_text("from", row.help_from),
        _help_text("for", row.help_for),
        f"moved {row.moved_kw:.1f}" if row.node == CENTRAL and row.moved_kw else "",
        "need: " + ", ".join(map(_short, row.needy)) if row.needy else "",
        f"stale for {stale}" if stale else "",
        "" if stored_kwh is None else f"holds {stored_kwh:,.1f} kWh",
        in_words(row.missing),
        *row.notices,
    ]
    return "; ".join(filter(None, parts))


def _help_text(word: str, lines: Sequence[HelpLine]) -> str:
    given = ", ".join(f"{_short(line.node)} {line.power_kw:.1f}" for line in lines)
    return f"{word} {given}" if given else ""


def _short(path: str) -> str:
    """Return the last part of a path: help is given among siblings."""
    return path.rpartition("/")[2]
