"""`heliarch inspect`: what a recording holds, nodes cycle by cycle, or the plant in one cycle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rich.text import Text

from bus_schemas.errors import InputError
from bus_schemas.printable import printable
from bus_schemas.tree import agent_name
from launch_scripts.commands.boundary import OK, complain
from launch_scripts.commands.output import progress_bar, write_json, write_rows
from studies.tables import (
    Column,
    Table,
    attributes,
    cell_text,
    console_for,
    key_column,
    print_table,
    texts_table,
    word_column,
)

if TYPE_CHECKING:
    from rich.console import Console

    from recordings.inspect.overview import Overview
    from recordings.inspect.timeline import NodeCycle
    from recordings.read.reader import RunReader

_SHOWN_GAPS: Final = 10


def inspect(
    run: Path,
    nodes: str | None = None,
    start: str | None = None,
    end: str | None = None,
    cycle: str | None = None,
    json: str | None = None,
) -> int:
    """Show what a recording holds, nodes cycle by cycle, or the whole plant in one cycle.

    Without --nodes and --cycle: plant, time span, versions, messages and rate
    of each signal, the health of the run, and what is missing.

    --nodes NODES: Show these nodes cycle by cycle: c2/inv07,c1/*,central (c1/*: c1 and all below).
    --cycle TIME: Show the whole plant in this cycle; same forms as --from.
    Example: heliarch inspect RUN --nodes c2/inv07 --from 13:49:00 --to 13:50:30
    """
    from recordings.read.reader import RunReader
    from recordings.read.selection import find_nodes

    if cycle is not None and (start or end or nodes):
        raise InputError("--cycle: expected neither --nodes, --from nor --to with it")
    console = console_for(json)
    with RunReader(run, skip_damaged=True) as reader:
        if cycle is not None:
            write_json(_show_plant(reader, reader.clock.cycle(cycle, "--cycle"), console), json)
        elif nodes is not None:
            names = find_nodes(reader.plan.tree, nodes)
            cycles = reader.clock.span(start, end)
            write_rows(_show_nodes(reader, names, cycles, console), json)
        else:
            part = None if start is None and end is None else reader.clock.span(start, end)
            write_json(_show_overview(reader, part, console), json)
        if not reader.whole:
            text = (
                f"{reader.path} or a file that it goes on in was cut, is damaged, or is still "
                "being recorded. `heliarch recover` makes a whole file of it."
            )
            console.print(Text(text, "yellow"))
        damage = reader.damage_text()
    return complain(damage, OK) if damage else OK


# Nodes, cycle by cycle ----------------------------------------------------------------------


def _show_nodes(
    run: RunReader, nodes: Sequence[str], cycles: range, console: Console
) -> Iterator[NodeCycle]:
    """Print nodes cycle by cycle, of a recording of any length; yield each line's node."""
    from recordings.inspect.timeline import heading, node_columns, row_text, timeline

    for node in nodes:
        if len(nodes) > 1:
            _print_lines(console, [agent_name(node)], "bold")
        columns = node_columns(run.plan.tree, node, len(run.clock.text(0)))
        _print_lines(console, [heading(columns)], "bold")
        for (row,) in timeline(run, [node], cycles):
            _print_lines(console, [row_text(columns, row)], _style(row))
            yield row


def _style(row: NodeCycle) -> str:
    """Highlight nodes that need help, and nodes with missing inputs."""
    return "red" if row.help_asked_kw else "yellow" if row.missing or row.stale_cycles else ""


# The plant in one cycle ----------------------------------------------------------------------


def _show_plant(run: RunReader, cycle: int, console: Console) -> Sequence[NodeCycle]:
    from recordings.inspect.timeline import plant_lines, timeline

    found = next(timeline(run, run.plan.tree.nodes, range(cycle, cycle + 1)), None)
    if found is None:
        nothing = f"{run.path}: there is no message of cycle {cycle}, {run.clock.extent()}"
        raise InputError(run.damage_text() or nothing)
    central = found[0]
    _print_lines(console, [f"cycle {cycle}, {run.clock.local(cycle):%Y-%m-%d} {central.time}"])
    _print_lines(console, [_plant_text(central)])
    names, *lines = plant_lines(run.plan.tree, found)
    _print_lines(console, ["", names], "bold")
    _print_lines(console, lines)
    return found


def _plant_text(central: NodeCycle) -> str:
    """Return desired, possible and produced power of the plant as a line."""
    values_kw = (
        central.dispatch_kw,
        central.commitment_kw,
        central.possible_kw,
        central.delivered_kw,
    )
    texts = (cell_text(value_kw, Column("power", decimals=2)) for value_kw in values_kw)
    return "dispatch {} kW (commitment {} kW), possible {} kW, produced {} kW".format(*texts)


def _print_lines(console: Console, lines: Iterable[str], style: str = "") -> None:
    # Together: each call of `print` costs more than a line.
    console.print(Text("\n".join(map(printable, lines)), style), soft_wrap=True)


# The whole recording -------------------------------------------------------------------------


def _show_overview(run: RunReader, cycles: range | None, console: Console) -> Overview:
    from recordings.inspect.health import health_lines
    from recordings.inspect.overview import facts, read_overview

    with progress_bar("reading") as run.follow:
        found = read_overview(run, cycles)
    columns = (
        key_column("signal"),
        Column("nodes"),
        Column("messages"),
        Column("per cycle", decimals=2, name="per_cycle"),
        Column("per s", decimals=1, name="per_s"),
        Column("lost"),
        Column("repeated"),
        Column("cycles without", name="missing_cycles"),
    )
    gaps = tuple(
        (gap.port, f"{gap.cycles:,} {run.clock.span_text(gap.first_cycle, gap.last_cycle)}")
        for gap in found.gaps[:_SHOWN_GAPS]
    )
    tables = [
        texts_table(found.run_id, facts(run, found)),
        Table("Signals", columns, attributes(found.signals, columns)),
        texts_table("Health of the run", health_lines(found.health, run.clock)),
    ]
    if found.gaps:
        title = f"Cycles without a message that was due: the first {_SHOWN_GAPS} gaps"
        tables.append(Table(title, (key_column("key"), word_column("cycles")), gaps))
    for table in tables:
        print_table(console, table)
    return found
