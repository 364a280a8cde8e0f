"""The tables of a report: health of a run and its devices, figures of merit of runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from recordings.inspect.overview import Overview
from recordings.read.run_clock import RunClock
from recordings.read.series import RunSeries
from results.figures import Shown, run_figures, runs_as_columns, shown_in
from results.health_lines import health_lines
from results.run_document import Outcome
from results.tables import Column, Table, attributes, key_column, texts_table
from sunspec.process import DeviceAccount

_COMMITMENT_NOTE: Final = (
    "Unavoidable is the shortfall that no controller could have prevented: less power was "
    "available than dispatched. Mileage is that of the shortfall, max(0, dispatch - delivered). "
    "RMSE and MAE are of delivered power against the dispatch. Rises and falls of delivered power "
    "are per minute."
)
_REGULATION_NOTE: Final = (
    "A request lasts 2 s, or one cycle if that is longer. It is fulfilled if delivered power stays "
    "within the given share of the plant's rating. PJM's score goes from 0 to 1; 0.75 passes."
)


def figures_tables(series: Sequence[RunSeries]) -> list[Table]:
    """Return the tables of figures of merit: how the commitment was kept, and regulation if any."""
    runs = [(one.label, run_figures(one)) for one in series]
    commitment, regulation = (
        shown_in(Shown.REPORT, group) for group in (Shown(0), Shown.REGULATION)
    )
    if not any(one["capacity"] for _, one in runs):  # It would be the curtailed energy again.
        commitment = tuple(one for one in commitment if one.name != "ancillary-potential")
    tables = [
        runs_as_columns("How the commitment was kept", runs, commitment, (_COMMITMENT_NOTE,)),
        runs_as_columns(
            "How the regulation signal was followed", runs, regulation, (_REGULATION_NOTE,)
        ),
    ]
    return [table for table in tables if table.rows]


def health_table(overview: Overview, clock: RunClock, outcome: Outcome) -> Table:
    """Return the table of a run's health, a line for each kind of finding."""
    return texts_table("Health of the run", health_lines(overview, clock, outcome))


def devices_tables(devices: Iterable[DeviceAccount]) -> list[Table]:
    """Return the table of how fast a run's real inverters answered; none where it had none."""
    columns = (
        key_column("device", "node"),
        Column("reads", name="reads.count"),
        Column("reads p50", "ms", 1, name="reads.p50_ms"),
        Column("reads p99", "ms", 1, name="reads.p99_ms"),
        Column("writes", name="writes.count"),
        Column("writes p50", "ms", 1, name="writes.p50_ms"),
        Column("writes p99", "ms", 1, name="writes.p99_ms"),
        Column("late"),
        Column("refused"),
        Column("breaks"),
        Column("gone for", "s", 1, name="gone_s"),
        Column("over limit", "kW", 1, name="excess_kw"),
    )
    rows = attributes(devices, columns)
    notes = (
        "how long it takes over Modbus to read all that is needed, and to write a limit",
        "late: readings that came after the end of their cycle",
        "over limit: most power beyond a limit that the inverter had acknowledged",
        "gone for: since the link broke, of a device that was not back at the end of the run",
    )
    return [Table("Devices", columns, rows, notes)] if rows else []
