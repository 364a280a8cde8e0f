"""Two recorded runs side by side: their figures of merit, and where their messages first differ."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agents.control.grid import gross_kw
from bus_schemas.errors import InputError
from bus_schemas.tree import PLANT
from recordings.read.reader import RunReader
from recordings.read.run_file import RECORDING_NAME
from recordings.read.series import RunSeries, series_of
from results.figures import Shown, run_figures, runs_as_columns, shown_in
from results.headline import headline
from results.message_differences import message_differences
from results.report.plant_figures import plant_power
from results.report.result import Result
from results.report.run_report import run_line, runs_result
from results.scenario_differences import scenario_differences
from results.tables import Table, json_rows

_ARRAYS: Final = (
    *("commitment_kw", "regulation_kw", "dispatch_kw", "mpp_kw"),
    *("residual_kw", "power_kw"),
)
"""What a run has cycle by cycle; what no controller decides comes first."""

_GIVEN: Final = _ARRAYS[:4]


def diff_runs(paths: tuple[Path, Path]) -> Result:
    """Put two recordings side by side: what differs in their scenarios comes first."""
    with RunReader(paths[0]) as first, RunReader(paths[1]) as second:
        scenarios = scenario_differences(first, second)
    series, lines = _read_both(paths)
    figures, found = _figures_table(*series), message_differences(paths, series)
    tables = [scenarios, figures, found.table]
    names = "scenario", "figures", "differences"
    document: dict[str, object] = {"runs": [str(path) for path in paths]}
    document |= {name: json_rows(table) for name, table in zip(names, tables, strict=True)}
    document |= {"compared": found.compared, "messages": found.messages, "equal": found.equal}
    title = " and ".join(_name(path) for path in paths)
    result = runs_result(title, series, tables, lines, document, names_gaps=False)
    return replace(result, verdict=(found.equal, found.verdict))


def with_and_without_help(path: Path) -> Result:
    """Put a recording beside what its sky would have given without help between inverters."""
    with RunReader(path) as reader:
        series = replace(series_of(reader), label="with help")
        lines = [run_line(reader.plan)]
    if not np.isfinite(series.without_help_kw).any():
        raise InputError(f"{path}: expected a cycle with the power of each inverter, got none")
    both = [series, _without_help(series)]
    table = _figures_table(*both)
    title = f"{_name(path)}, with help and without"
    result = runs_result(title, both, [table], lines, json_rows(table))
    found = f"{headline(run_figures(series)).capitalize()}."
    return replace(result, headline=found, figures=lambda: [plant_power(both)])


def _without_help(series: RunSeries) -> RunSeries:
    """Return a run's baseline as a run of its own, with one column for the whole plant."""
    law, alone_kw = series.plan.grid_law, series.without_help_kw
    asked = "commitment_kw", "regulation_kw", "dispatch_kw", "frequency_hz"
    values = {name: getattr(series, name) for name in asked}
    for name, powers_kw in (("mpp_kw", series.available_kw), ("power_kw", alone_kw)):
        values[name] = np.array([gross_kw(kw, law) for kw in powers_kw.tolist()])[:, None]
    alone = RunSeries.of(series.plan, "without help", values, (PLANT,))
    return replace(alone, first_cycle=series.first_cycle, baseline_kw=alone_kw)


def _name(path: Path) -> str:
    """Return what to call a recording: its folder, unless its file has a name of its own."""
    return path.resolve().parent.name if path.name == RECORDING_NAME else path.name


def _read_both(paths: tuple[Path, Path]) -> tuple[list[RunSeries], list[str]]:
    """Read two recordings as A and B, the cycles that both have, and what a reader must know."""
    series, lines = [], []
    for label, path in zip("AB", paths, strict=True):
        with RunReader(path) as reader:
            lines.append(f"{label}: {path}, run {reader.plan.run_id}. {run_line(reader.plan)}")
            series.append(replace(series_of(reader), label=label))
    cycles = min(one.cycles for one in series)
    lengths = [(int(one.known.sum()), one.plan.timing.cycles) for one in series]
    first, second = (one.between(0, cycles) for one in series)
    if first.inverters != second.inverters:
        raise InputError(f"{paths[1]}: expected the inverters of {paths[0]}, got others")
    if (first.start_time_ns, first.cycle_s) != (second.start_time_ns, second.cycle_s):
        begins = [f"{one.times[0]}, cycles of {one.cycle_s:g} s" for one in (first, second)]
        expected = f"the beginning of {paths[0]}, {begins[0]}"
        raise InputError(f"{paths[1]}: expected {expected}, got {begins[1]}")
    both = first.known & second.known
    if not both.any():
        raise InputError(f"{paths[1]}: expected a cycle that {paths[0]} has recorded too, got none")
    if both.sum() < max(planned for _, planned in lengths):
        of = [f"{known:,} of {planned:,}" for known, planned in lengths]
        which = f"which both have recorded: A has {of[0]}, B has {of[1]}"
        lines.append(f"{both.sum():,} cycles are compared, {which}.")
    first, second = series = [_only(one, both) for one in (first, second)]
    if any(_differ(first, second, name).any() for name in _GIVEN):
        lines.append("Sky or dispatch differ: figures of available power and regulation show A's.")
    return series, lines


def _only(series: RunSeries, cycles: NDArray[np.bool_]) -> RunSeries:
    """Return a run as if only some of its cycles had been recorded."""
    arrays = {name: getattr(series, name).copy() for name in _ARRAYS}
    for array in arrays.values():
        array[~cycles] = np.nan
    return replace(series, **arrays)


def _differ(first: RunSeries, second: RunSeries, name: str) -> NDArray[np.bool_]:
    """Return where an array of two runs differs, bit for bit, shape (T, 1) or (T, n)."""
    a, b = (getattr(one, name).reshape(one.cycles, -1) for one in (first, second))
    return np.asarray(~((a == b) | (np.isnan(a) & np.isnan(b))))


def _figures_table(first: RunSeries, second: RunSeries) -> Table:
    runs = [(one.label, run_figures(one)) for one in (first, second)]
    figures = shown_in(Shown.REPORT | Shown.COMPARE)
    title = f"Figures of merit, {second.label} less {first.label}"
    return runs_as_columns(title, runs, figures, difference=True)
