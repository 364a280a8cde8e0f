"""Two recorded runs side by side: their figures of merit, and where they first differ."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bus_schemas.errors import InputError
from recordings.read.gaps import recorder_absences
from recordings.read.reader import RunReader
from recordings.read.series import RunSeries, read_series
from studies.metrics import run_metrics
from studies.metrics.figures_of_merit import FIGURES_OF_MERIT, runs_as_columns
from studies.report.run_report import run_line, when
from studies.report.style import clock_text
from studies.tables import Cell, Column, Number, Table, key_column, word_column

_IN_ORDER: Final = {
    "commitment_kw": "dispatch, commitment",
    "regulation_kw": "dispatch, regulation",
    "impp_kw": "impp",
    "residual_kw": "residual",
    "alpha": "command, alpha",
    "mpp_kw": "production, maximum",
    "power_kw": "production, power",
}
"""What is compared: messages in the order in which they lead to each other within a cycle."""

_GIVEN: Final = ("commitment_kw", "regulation_kw", "mpp_kw")
"""What no controller decides."""


def read_two_runs(paths: tuple[Path, Path]) -> tuple[list[RunSeries], list[str]]:
    """Read two recordings as A and B, the cycles that both have, and a line about each."""
    series, lines = [], []
    away: set[int] = set()
    for label, path in zip("AB", paths, strict=True):
        with RunReader(path) as reader:
            away.update(*(absence for _, absence in recorder_absences(reader)))
            lines.append(f"{label}: {path}, run {reader.plan.run_id}. {run_line(reader.plan)}")
        series.append(replace(read_series(path), label=label))
    cycles = min(one.cycles for one in series)
    if any(one.cycles > cycles for one in series):
        lengths = " and ".join(f"{one.cycles:,}" for one in series)
        lines.append(f"A and B have {lengths} cycles; the first {cycles:,} are compared.")
    first, second = series = [one.between(0, cycles) for one in series]
    if first.inverters != second.inverters:
        raise InputError(f"{paths[1]}: expected the inverters of {paths[0]}, got others")
    if (first.start_time_ns, first.cycle_s) != (second.start_time_ns, second.cycle_s):
        raise InputError(f"{paths[1]}: expected {when(first)} as in {paths[0]}, got {when(second)}")
    left_out = ~(first.known & second.known) | np.isin(np.arange(cycles), list(away))
    if left_out.any():
        lines.append(
            f"{left_out.sum():,} of {cycles:,} cycles are left out: A or B has not recorded them."
        )
        first, second = series = [_without(one, left_out) for one in series]
    if left_out.all():
        raise InputError(f"{paths[1]}: expected a cycle that {paths[0]} has recorded too, got none")
    if any(_differ(first, second, name).any() for name in _GIVEN):
        lines.append("Sky or dispatch differ: figures of possible power and regulation show A's.")
    return series, lines


def _without(series: RunSeries, cycles: NDArray[np.bool_]) -> RunSeries:
    """Return a run as if some of its cycles had not been recorded."""
    arrays = {name: getattr(series, name).copy() for name in _IN_ORDER}
    for array in arrays.values():
        array[cycles] = np.nan
    return replace(series, **arrays)


def _differ(first: RunSeries, second: RunSeries, name: str) -> NDArray[np.bool_]:
    """Return where an array of two runs differs, bit for bit, shape (T, 1) or (T, n)."""
    a, b = (getattr(one, name).reshape(one.cycles, -1) for one in (first, second))
    return np.asarray(~((a == b) | (np.isnan(a) & np.isnan(b))))


def two_runs_tables(first: RunSeries, second: RunSeries) -> list[Table]:
    """Return the figures of merit side by side, and where the runs first differ."""
    runs = [(one.label, run_metrics(one)) for one in (first, second)]
    figures = [one for one in FIGURES_OF_MERIT.values() if set("RC") & set(one.shown)]
    merits = runs_as_columns("Figures of merit, B less A", runs, figures, difference=True)
    return [merits, _differences(first, second)]


def _differences(first: RunSeries, second: RunSeries) -> Table:
    """Return for each message the first cycle and node in which it differs, bit for bit."""
    rows: list[tuple[int, tuple[Cell, ...]]] = []
    for name, title in _IN_ORDER.items():
        differ = _differ(first, second, name)
        cycles = np.flatnonzero(differ.any(axis=1))
        if not len(cycles):
            continue
        cycle = int(cycles[0])
        column = int(differ[cycle].argmax())
        arrays = [getattr(one, name) for one in (first, second)]
        node = first.inverters[column] if arrays[0].ndim > 1 else "plant"
        values = (Number(float(np.atleast_1d(array[cycle])[column]), 6) for array in arrays)
        rows.append((cycle, (title, node, cycle, clock_text(first, cycle), *values, len(cycles))))
    rows.sort(key=lambda row: row[0])
    columns = (
        key_column("message"),
        word_column("node"),
        Column("cycle"),
        Column("time"),
        *(Column(one.label) for one in (first, second)),
        Column("cycles that differ"),
    )
    note = "the first line is where it began" if rows else "nowhere: all are the same, bit for bit"
    return Table("Where A and B first differ [kW]", columns, tuple(row for _, row in rows), (note,))
