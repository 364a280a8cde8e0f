"""`heliarch inspect`: what a recording holds, nodes cycle by cycle, or the plant in one cycle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import TYPE_CHECKING, Annotated, Any, Final

import msgspec
from cyclopts import Parameter
from rich.text import Text

from bus_schemas.errors import InputError
from bus_schemas.selection import find_nodes
from heliarch.cli.options import End, Json, Nodes, Run, Start
from heliarch.cli.output import Output, progress_bar
from results.tables import Column, Table, attributes, cell_text, key_column, texts_table
from sunspec.process import read_accounts

if TYPE_CHECKING:
    from recordings.inspect.timeline import NodeCycle
    from recordings.read.reader import RunReader

_ROWS: Final = 60
"""Cycles of a node in one table: its heading stays in sight, and a day is not kept in memory."""


def inspect(
    run: Run,
    /,
    *,
    nodes: Nodes = None,
    start: Start = None,
    end: End = None,
    cycle: Annotated[str | None, Parameter(metavar="TIME")] = None,
    json: Json = None,
) -> None:
    """Show what a recording holds, by node or by cycle.

    Or the whole plant in one cycle.

    With --nodes, these nodes cycle by cycle. Without --nodes and --cycle: plant, time span,
    versions, messages and rate of each signal, the health of the run, and what is missing.

    Example: `heliarch inspect RUN --nodes c2/inv07 --from 13:49:00 --to 13:50:30`

    Parameters
    ----------
    cycle
        Show the whole plant in this cycle: its number, or a time in the forms of --from.
    """
    from recordings.read.reader import RunReader

    if cycle is not None and nodes:
        raise InputError.of("--cycle", "expected no --nodes with it")
    if nodes is None and (start or end):
        raise InputError.of("--from, --to", "expected --nodes with it")
    output = Output(json)
    with RunReader(run) as reader:
        if cycle is not None:
            moment = f"c{cycle}" if cycle.isdigit() else cycle
            output.write(_show_plant(reader, reader.clock.cycle(moment, "--cycle"), output))
        elif nodes is not None:
            names, cycles = find_nodes(reader.plan.tree, nodes), reader.clock.span(start, end)
            output.write_rows(_show_nodes(reader, names, cycles, output))
        else:
            output.write(_show_overview(reader, output))
        if not reader.whole:
            text = (
                f"{reader.path} or one of the files that continue it is missing, was cut, is "
                "damaged, or is still being recorded. `heliarch export --format mcap` makes a "
                "whole file of it."
            )
            output.console.print(Text(text, "yellow"))


def _show_nodes(
    run: RunReader, nodes: Sequence[str], cycles: range, output: Output
) -> Iterator[dict[str, Any]]:
    """Print nodes cycle by cycle, of a recording of any length; yield each row."""
    from recordings.inspect.timeline import timeline
    from results.timeline_tables import node_table

    found = timeline(run, nodes, cycles)
    while part := list(islice(found, _ROWS)):
        for node, rows in zip(nodes, zip(*part, strict=True), strict=True):
            output.show(node_table(run.plan.tree, node, rows))
            yield from (row.document() for row in rows)


def _show_plant(run: RunReader, cycle: int, output: Output) -> dict[str, Any]:
    """Print the whole plant in one cycle; return the same as JSON."""
    from recordings.inspect.agent_states import states_of
    from recordings.inspect.timeline import timeline
    from recordings.read.series import plant_series_of
    from results.figures import run_figures
    from results.plants import plant_figures, plants_tables
    from results.summary_table import figures_table
    from results.timeline_tables import plant_table, states_table

    tree = run.plan.tree
    nodes = next(timeline(run, tree.nodes, range(cycle, cycle + 1)), None)
    if nodes is None:
        nothing = f"{run.path}: there is no message of cycle {cycle}, {run.clock.extent()}"
        raise InputError(run.damage_text() or nothing)
    central = nodes[0]
    date = f"{run.clock.local(cycle):%Y-%m-%d}"
    title = f"Cycle {cycle}, {date} {central.time}: {_plant_text(central)}"
    output.show(plant_table(tree, title, nodes))
    with progress_bar("reading what led to it") as run.follow:
        followed = states_of(run)
    states = {agent: followed.at(agent, cycle) for agent in followed.agents}
    output.show(states_table(states))
    # By cluster, as the live page adds up: both say the same to the last bit.
    series = plant_series_of(run).between(0, cycle + 1)
    figures = run_figures(series) if series.known.any() else None
    output.show(figures_table("Figures of merit up to this cycle", figures))
    for table in plants_tables(plants := [*plant_figures(series)]):
        output.show(table)
    return {
        "cycle": cycle,
        "time": central.time,
        "figures": figures,
        "plants": plants,
        "agents": {agent: state.document() for agent, state in states.items()},
        "nodes": [node.document() for node in nodes],
    }


def _plant_text(central: NodeCycle) -> str:
    """Return dispatch, available and delivered power of the plant, and the frequency, as a line."""
    names = ("dispatch_kw", "commitment_kw", "available_kw", "delivered_kw")
    column = Column("power", decimals=1)
    texts = (cell_text(central.values.get(name), column) for name in names)
    text = "dispatch {} kW (commitment {} kW), available {} kW, delivered {} kW".format(*texts)
    frequency_hz = central.values.get("frequency_hz")
    return text if frequency_hz is None else f"{text}, frequency {frequency_hz:.3f} Hz"


def _show_overview(run: RunReader, output: Output) -> dict[str, Any]:
    """Print what the recording holds; return the same."""
    from recordings.inspect.overview import facts
    from results.report.tables import devices_tables, health_table
    from results.run_document import outcome_of, overview_of

    with progress_bar("reading") as run.follow:
        found, outcome = overview_of(run), outcome_of(run)
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
    output.show(
        texts_table(found.run_id, facts(run, found)),
        Table("Signals", columns, attributes(found.signals, columns)),
        health_table(found, run.clock, outcome),
        *devices_tables(read_accounts(run.path.parent)),
    )
    return {**msgspec.structs.asdict(found), "end": outcome.text}
