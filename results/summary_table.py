"""The table at the end of a run: its pace, its figures of merit, its messages, its memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeAlias

from rich.console import Console

from bus_schemas.errors import InputError
from recordings.read.reader import RunReader
from results.answers import answers_tables
from results.figures import FIGURES, Figures, Shown, shown_in
from results.health_lines import counts_text
from results.plants import plants_tables
from results.report.tables import devices_tables, health_table
from results.run_document import Outcome, RunDocument
from results.tables import Cell, Column, Number, Table, key_column, print_table, word_column

Row: TypeAlias = tuple[str, Cell, str, str]
"""Name, value, unit and note."""

_COLUMNS: Final = (key_column(""), Column(""), word_column(""), word_column(""))
_GAP: Final = ("", "", "", "")


def print_summary(summary: RunDocument, console: Console) -> None:
    """Print the table; then the health of a run with faults, or in which something went wrong."""
    tables = (
        summary_table(summary),
        *plants_tables(summary.plants),
        *answers_tables(summary.answers),
    )
    for table in (*tables, *devices_tables(summary.devices)):
        print_table(console, table)
    with suppress(InputError), RunReader(Path(summary.folder)) as run:
        if summary.recording and (summary.is_incomplete or run.plan.faults.rules):
            print_table(console, health_table(summary.recording, run.clock, Outcome(summary)))


def summary_table(summary: RunDocument) -> Table:
    return Table(
        f"{summary.scenario} from {summary.sim_start}, {summary.driver}",
        _COLUMNS,
        (
            *_pace_rows(summary),
            *_offset_rows(summary),
            _GAP,
            *_figure_rows(summary),
            _GAP,
            *_message_rows(summary),
            *_external_rows(summary),
            _GAP,
            *_process_rows(summary),
        ),
    )


def _pace_rows(summary: RunDocument) -> Iterator[Row]:
    rate, cycle_s, planned = summary.cycles_per_s, summary.cycle_s, summary.planned_cycles
    note = f"of {cycle_s:g} s"
    if summary.cycles < planned:
        note += f"; {Outcome(summary).text}"
    yield "Cycles", summary.cycles, "", note
    yield "Cycle rate", Number(rate, 1), "/s", f"{rate * cycle_s:,.0f} x real time"
    yield "Wall time", Number(summary.wall_s, 1), "s", f"after {summary.startup_s:.1f} s to start"


def _offset_rows(summary: RunDocument) -> Iterator[Row]:
    """Say how far from its dispatch the plant aimed, if it did."""
    if summary.offset_kw:
        yield "Offset", Number(summary.offset_kw, 1), "kW", "aimed above the dispatch"
    if summary.offset_errors:
        yield "Offset", Number(summary.offset_errors, 2), "", "mean errors aimed above the dispatch"


def figures_table(title: str, figures: Figures | None) -> Table:
    """Return the figures of merit of a run, or of a part of it."""
    return Table(title, _COLUMNS, tuple(_rows_of(figures)))


def _figure_rows(summary: RunDocument) -> Iterator[Row]:
    figures, planned = summary.figures, summary.planned_cycles
    if figures is not None and figures["cycles"] != planned:
        covered = f"{figures['cycles']:,.0f} of {planned:,} cycles"
        yield "Figures of merit", None, "", f"they cover {covered}"
    yield from _rows_of(figures)


def _rows_of(figures: Figures | None) -> Iterator[Row]:
    if figures is None:
        yield "Figures of merit", None, "", "none: no readable cycle"
        return
    for figure in shown_in(Shown.SUMMARY):
        value = figures[figure.name]
        share_name = figure.name.removesuffix("-energy")
        share = None if share_name == figure.name else figures.get(share_name)
        if value is not None:
            note = "" if share is None else f"{share:.3f} {FIGURES[share_name].unit}"
            if figure.name == "unknown-energy":
                note = "unknown, not among the delivered: what they are assumed to have given"
            yield figure.title, Number(value, figure.decimals), figure.unit, note


def _message_rows(summary: RunDocument) -> Iterator[Row]:
    dropped = summary.dropped
    help_calls = sum(count.recorded for count in summary.messages if count.signal == "help")
    published = sum(count.published for count in summary.messages)
    recorded = sum(count.recorded for count in summary.messages)
    yield "Messages published", published, "", f"{help_calls:,} of them calls for help"
    yield "Messages recorded", recorded, "", ""
    yield "Missing in the recording", summary.lost, "", ""
    yield "Messages dropped", sum(dropped.values()), "", counts_text(dropped)
    yield "Inputs missed at deadlines", summary.missing_inputs, "", ""


def _external_rows(summary: RunDocument) -> Iterator[Row]:
    for account in summary.external:
        answered = f"answered {account.answered:,} of {account.expected:,} times"
        refused = summary.refused(account)
        counts = {"lost": account.lost, "late": account.late, "refused": refused}
        notes = ["messages recorded", answered]
        notes += [f"{count:,} {name}" for name, count in counts.items() if count]
        yield f"External {account.agent}", sum(account.recorded.values()), "", "; ".join(notes)


def _process_rows(summary: RunDocument) -> Iterator[Row]:
    cpu_s = [process.cpu_s for process in summary.processes if process.cpu_s is not None]
    if summary.cycles and cpu_s:
        per_cycle = Number(1e3 * sum(cpu_s) / summary.cycles, 2)
        yield "Processor time per cycle", per_cycle, "ms", "all processes"
    if own_mb := [process.own_mb for process in summary.processes if process.own_mb]:
        yield "Memory", Number(sum(own_mb), 1), "MB", "of their own, all processes"
