"""Two recorded runs side by side: their figures of merit, and where they first differ."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bus_schemas.errors import InputError
from recordings.read.reader import RunReader
from recordings.read.run_file import RECORDING_NAME
from recordings.read.series import RunSeries, series_of
from results.figures import Shown, run_figures, runs_as_columns, shown_in
from results.report.result import Result
from results.report.run_report import run_line, runs_result, when
from results.report.style import clock_text
from results.scenario_differences import scenario_differences
from results.tables import Cell, Column, Number, Table, json_rows, key_column, word_column

_IN_ORDER: Final = {
    "commitment_kw": "dispatch, commitment",
    "regulation_kw": "dispatch, regulation",
    "dispatch_kw": "dispatch, power",
    "impp_kw": "impp",
    "residual_kw": "residual",
    "alpha": "command, alpha",
    "mpp_kw": "production, maximum",
    "power_kw": "production, power",
}
"""What is compared: messages in the order in which they lead to each other within a cycle."""

_GIVEN: Final = ("commitment_kw", "regulation_kw", "dispatch_kw", "mpp_kw")
"""What no controller decides."""


def compare_runs(paths: tuple[Path, Path]) -> Result:
    """Put two recordings side by side: what differs in their scenarios comes first."""
    with RunReader(paths[0]) as first, RunReader(paths[1]) as second:
        scenarios = scenario_differences(first, second)
    series, lines = read_two_runs(paths)
    tables = [scenarios, *two_runs_tables(*series)]
    names = "scenario", "figures", "differences"
    document: dict[str, object] = {"runs": [str(path) for path in paths]}
    document |= {name: json_rows(table) for name, table in zip(names, tables, strict=True)}
    title = " and ".join(_name(path) for path in paths)
    return runs_result(title, series, tables, lines, document)


def _name(path: Path) -> str:
    """Return what to call a recording: its folder, unless its file has a name of its own."""
    return path.resolve().parent.name if path.name == RECORDING_NAME else path.name


def read_two_runs(paths: tuple[Path, Path]) -> tuple[list[RunSeries], list[str]]:
    """Read two recordings as A and B, the cycles that both have, and what a reader must know."""
    series, lines = [], []
    for label, path in zip("AB", paths, strict=True):
        with RunReader(path) as reader:
            lines.append(f"{label}: {path}, run {reader.plan.run_id}. {run_line(reader.plan)}")
            series.append(replace(series_of(reader), label=label))
    cycles = min(one.cycles for one in series)
    longest = max(one.cycles for one in series)
    first, second = (one.between(0, cycles) for one in series)
    if first.inverters != second.inverters:
        raise InputError(f"{paths[1]}: expected the inverters of {paths[0]}, got others")
    if (first.start_time_ns, first.cycle_s) != (second.start_time_ns, second.cycle_s):
        raise InputError(f"{paths[1]}: expected {when(first)} as in {paths[0]}, got {when(second)}")
    both = first.known & second.known
    if not both.any():
        raise InputError(f"{paths[1]}: expected a cycle that {paths[0]} has recorded too, got none")
    if both.sum() < longest:
        lines.append(
            f"{both.sum():,} of {longest:,} cycles are compared: those that both have recorded."
        )
    first, second = series = [_only(one, both) for one in (first, second)]
    if any(_differ(first, second, name).any() for name in _GIVEN):
        lines.append("Sky or dispatch differ: figures of available power and regulation show A's.")
    return series, lines


def _only(series: RunSeries, cycles: NDArray[np.bool_]) -> RunSeries:
    """Return a run as if only some of its cycles had been recorded."""
    arrays = {name: getattr(series, name).copy() for name in _IN_ORDER}
    for array in arrays.values():
        array[~cycles] = np.nan
    return replace(series, **arrays)


def _differ(first: RunSeries, second: RunSeries, name: str) -> NDArray[np.bool_]:
    """Return where an array of two runs differs, bit for bit, shape (T, 1) or (T, n)."""
    a, b = (getattr(one, name).reshape(one.cycles, -1) for one in (first, second))
    return np.asarray(~((a == b) | (np.isnan(a) & np.isnan(b))))


def two_runs_tables(first: RunSeries, second: RunSeries) -> list[Table]:
    """Return the figures of merit side by side, and where the runs first differ."""
    runs = [(one.label, run_figures(one)) for one in (first, second)]
    figures = shown_in(Shown.REPORT | Shown.COMPARE)
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
        node = first.inverters[column] if getattr(first, name).ndim > 1 else "plant"
        values = (
            Number(float(getattr(one, name).reshape(differ.shape)[cycle, column]), 6)
            for one in (first, second)
        )
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
