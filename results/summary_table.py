"""The table at the end of a run: its pace, its figures of merit, its messages, its memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeAlias

from msgspec.structs import replace
from rich.console import Console

from bus_schemas.errors import InputError
from recordings.inspect.health import counts_text
from recordings.inspect.overview import read_overview
from recordings.read.reader import RunReader
from results.metrics import RunMetrics
from results.metrics.figures_of_merit import FIGURES_OF_MERIT, Shown, shown_in
from results.report.tables import devices_tables, health_table
from results.run_summary import RunSummary
from results.tables import Cell, Column, Number, Table, key_column, print_table, word_column

Row: TypeAlias = tuple[str, Cell, str, str]
"""Name, value, unit and note."""

_COLUMNS: Final = (key_column(""), Column(""), word_column(""), word_column(""))
_GAP: Final = ("", "", "", "")

_SHARES: Final = {
    "shortfall-energy": FIGURES_OF_MERIT["shortfall"],
    "unavoidable-energy": FIGURES_OF_MERIT["unavoidable"],
    "control-caused-energy": FIGURES_OF_MERIT["control-caused"],
    "over-delivered-energy": FIGURES_OF_MERIT["over-delivered"],
}
"""Energies that are shown in % of the dispatched energy as well."""


def print_summary(summary: RunSummary, console: Console) -> None:
    """Print the table; then the health of a run with faults, or in which something went wrong."""
    for table in (summary_table(summary), *devices_tables(summary.devices)):
        print_table(console, table)
    with suppress(InputError), RunReader(Path(summary.folder)) as run:
        if summary.is_incomplete or run.plan.faults.rules:
            health = summary.health or read_overview(run).health
            health = replace(health, launcher=summary)
            print_table(console, health_table(health, run.clock))


def summary_table(summary: RunSummary) -> Table:
    hindsight = "Clusters and neighbours were chosen from the run's own data: hindsight."
    return Table(
        f"{summary.scenario} from {summary.sim_start}, {summary.driver}",
        _COLUMNS,
        (
            *_pace_rows(summary),
            _GAP,
            *_metrics_rows(summary.metrics),
            _GAP,
            *_message_rows(summary),
            *_external_rows(summary),
            _GAP,
            *_process_rows(summary),
        ),
        (hindsight,) if summary.hindsight_neighbours else (),
    )


def _pace_rows(summary: RunSummary) -> Iterator[Row]:
    rate, recorded = summary.cycles_per_s, summary.recorded_cycles
    note = f"of {summary.cycle_s:g} s"
    if recorded < summary.cycles:
        note += f"; {recorded:,} of them recorded: the figures are of these"
    yield "Cycles", summary.cycles, "", note
    yield "Cycle rate", Number(rate, 1), "/s", f"{rate * summary.cycle_s:,.0f} x real time"
    yield "Wall time", Number(summary.wall_s, 1), "s", f"after {summary.startup_s:.1f} s to start"


def _metrics_rows(metrics: RunMetrics | None) -> Iterator[Row]:
    if metrics is None:
        yield "Figures of merit", None, "", "no cycle was completed"
        return
    for figure in shown_in(Shown.SUMMARY):
        value = figure.read(metrics)
        share = _SHARES.get(figure.name)
        percent = share.read(metrics) if share else None
        if value is not None:
            note = "" if share is None or percent is None else f"{percent:.3f} {share.unit}"
            yield figure.title, Number(value, figure.decimals), figure.unit, note


def _message_rows(summary: RunSummary) -> Iterator[Row]:
    help_calls = sum(count.recorded for count in summary.messages if count.signal == "help")
    published = sum(count.published for count in summary.messages)
    recorded = sum(count.recorded for count in summary.messages)
    yield "Messages published", published, "", f"{help_calls:,} of them calls for help"
    yield "Messages recorded", recorded, "", ""
    yield "Missing in the recording", summary.lost, "", ""
    yield "Messages dropped", sum(summary.dropped.values()), "", counts_text(summary.dropped)
    yield "Inputs missed at deadlines", summary.missing_inputs, "", ""


def _external_rows(summary: RunSummary) -> Iterator[Row]:
    for account in summary.external:
        answered = f"answered {account.answered:,} of {account.expected:,} times"
        own = [wrong for wrong in summary.wrong if wrong.publisher == account.agent]
        late = sum(wrong.count for wrong in own if wrong.cause == "late")
        refused = sum(wrong.count for wrong in own if wrong.cause not in {"late", "duplicate"})
        counts = {"lost": account.lost, "late": late, "refused": refused}
        notes = ["messages recorded", answered]
        notes += [f"{count:,} {name}" for name, count in counts.items() if count]
        for gone, back in account.outages:
            notes.append(f"gone from cycle {gone:,} to {'the end' if back is None else back}")
        yield f"External {account.agent}", sum(account.recorded.values()), "", "; ".join(notes)


def _process_rows(summary: RunSummary) -> Iterator[Row]:
    cpu_s = [process.cpu_s for process in summary.processes if process.cpu_s is not None]
    if summary.cycles and cpu_s:
        per_cycle = Number(1e3 * sum(cpu_s) / summary.cycles, 2)
        yield "Processor time per cycle", per_cycle, "ms", "all processes"
    for use in summary.memory:
        median = f", the median of {use.processes}" if use.processes > 1 else ""
        note = f"resident{median}; {use.own_median_mb:.1f} MB its own"
        yield f"Memory, {use.kind}", Number(use.resident_median_mb, 1), "MB", note
