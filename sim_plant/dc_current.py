"""DC currents of a real plant's combiner boxes, and the AC power of its inverters that they mean.

Currents of plants are published without their units, as a share of something that is not told.
The share is taken for that of the inverter's rating: an inverter whose combiners carry
`full_power_current` on average is at its rating, and no more comes out however bright it is. Which
current that is, is a convention of the scenario and not a property of the plant.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bus_schemas.errors import InputError
from bus_schemas.tree import check_name
from sim_plant.csv_tables import (
    check_no_column_twice,
    check_steady,
    named_rows,
    number,
    read_header,
    read_numbers,
    shown,
)

TIME_COLUMN: Final = "t_s"

# Sensors at rest read a little off zero; the brightest edge of a cloud does not double the sun.
_LOWEST_SHARE: Final = -0.02
_HIGHEST_SHARE: Final = 2.0
# A share of 1 in a file where percent are expected, or the other way round, is off by 100.
_FAINT_SHARE: Final = 0.02

_FURTHEST_M: Final = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class InverterCurrents:
    """Mean DC current of the combiners of n inverters at T time stamps.

    Attributes
    ----------
    time_ns : numpy.ndarray, shape (T,)
        Time since the beginning of the measurement [ns], with a constant step.
    share : numpy.ndarray, shape (T, n)
        Mean current over the current at full power, never negative.
    inverters : tuple of str
        Names of the inverters that are used.
    x_m, y_m : numpy.ndarray, shape (n,)
        Mean position of each inverter's combiners [m], east and north of an arbitrary point.
    listed : int
        How many inverters the positions name, those that are left out included.
    report : tuple of str
        What was missing, a line each.
    """

    time_ns: NDArray[np.int64]
    share: NDArray[np.float64]
    inverters: tuple[str, ...]
    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    listed: int
    report: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Combiner:
    name: str
    inverter: str
    x_m: float
    y_m: float


def read_currents(
    currents_csv: Path, positions_csv: Path, full_power_current: float, *, refuse_gaps: bool
) -> InverterCurrents:
    """Read the currents of combiners and take their mean for each inverter.

    `currents_csv` has the column `t_s`, seconds with a constant step, and one column for each
    combiner; a field may be empty. `positions_csv` has the columns `combiner, inverter, x_m, y_m`.

    Where some combiners of an inverter are missing the mean is over those that are there. An
    inverter of which all are missing throughout is left out.

    Parameters
    ----------
    currents_csv, positions_csv : pathlib.Path
        The two files.
    full_power_current : float
        Current at which an inverter is at its rating, in the unit of the file.
    refuse_gaps : bool
        Whether a missing value is an error instead.

    Returns
    -------
    InverterCurrents

    Raises
    ------
    InputError
        A file is not as described; a combiner has no position; a value is not from -2 % to 200 %
        of the current at full power, or all are faint beside it; an inverter has currents at some
        times and none at others.
    """
    header = read_header(currents_csv)
    combiners = _read_combiners(positions_csv)
    columns = _columns(currents_csv, header, combiners, positions_csv)
    accepted = "a number" + (", as irradiance.gaps is 'refuse'" if refuse_gaps else " or nothing")
    stamps, current = read_numbers(
        currents_csv, header, columns, accepted, empty_is_missing=not refuse_gaps
    )
    time_ns = _time_ns(currents_csv, stamps.to_list())
    _check_range(currents_csv, columns, current, full_power_current)
    share = np.maximum(current / full_power_current, 0.0)
    members: dict[str, list[_Combiner]] = {}
    for combiner in combiners.values():
        members.setdefault(combiner.inverter, []).append(combiner)
    means, report = _means(currents_csv, share, columns, members, refuse_gaps)
    return InverterCurrents(
        time_ns,
        np.column_stack(list(means.values())),
        tuple(means),
        np.array([np.mean([one.x_m for one in members[inverter]]) for inverter in means]),
        np.array([np.mean([one.y_m for one in members[inverter]]) for inverter in means]),
        len(members),
        tuple(report),
    )


def ac_power_kw(share: NDArray[np.float64], rating_kw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the AC power that the currents of inverters mean.

    Parameters
    ----------
    share : numpy.ndarray, shape (T, n)
        Mean DC current of each inverter over its current at full power.
    rating_kw : numpy.ndarray, shape (n,)
        AC rating of each inverter [kW].

    Returns
    -------
    numpy.ndarray, shape (T, n)
        AC power [kW], clipped at the rating.
    """
    return np.minimum(share, 1.0) * rating_kw


def _read_combiners(path: Path) -> dict[str, _Combiner]:
    found: dict[str, _Combiner] = {}
    for line, row in named_rows(path, ("combiner", "inverter", "x_m", "y_m")):
        name = row["combiner"]
        if name in found:
            raise InputError(
                f"{path.name}: line {line}: combiner '{name}' is there twice;"
                " accepted: one position per combiner"
            )
        check_name(row["inverter"], f"{path.name}: line {line}")
        found[name] = _Combiner(
            name, row["inverter"], _metres(path, line, row, "x_m"), _metres(path, line, row, "y_m")
        )
    return found


def _metres(path: Path, line: int, row: dict[str, str], column: str) -> float:
    value = number(row[column])
    if not abs(value) <= _FURTHEST_M:
        raise InputError(
            f"{path.name}: line {line}, column '{column}': {shown(row[column])};"
            f" accepted: metres from -{_FURTHEST_M:.0f} to {_FURTHEST_M:.0f}"
        )
    return value


def _columns(
    path: Path, header: tuple[str, ...], combiners: dict[str, _Combiner], positions: Path
) -> tuple[str, ...]:
    columns = header[1:]
    if header[0] != TIME_COLUMN:
        raise InputError(
            f"{path.name}: line 1: the first column is '{header[0]}'; accepted: {TIME_COLUMN},"
            " seconds from the beginning of the measurement"
        )
    if not columns:
        raise InputError(f"{path.name}: line 1: no combiner; accepted: at least one column")
    check_no_column_twice(path, columns, "one per combiner")
    for name in columns:
        if name not in combiners:
            raise InputError(
                f"{positions.name}: no position for combiner '{name}' of {path.name};"
                " accepted: a line for each combiner"
            )
    return columns


def _time_ns(path: Path, stamps: list[str]) -> NDArray[np.int64]:
    def place(row: int) -> str:
        text = stamps[row] if isinstance(stamps[row], str) else ""
        return f"{path.name}: line {row + 2}, column '{TIME_COLUMN}': {shown(text)}"

    time_s = np.array([number(text) if isinstance(text, str) else np.nan for text in stamps])
    bad = np.flatnonzero(~(np.abs(time_s) < 1e9))
    if bad.size:
        raise InputError(f"{place(int(bad[0]))}; accepted: a number of seconds")
    time_ns: NDArray[np.int64] = np.rint(time_s * 1e9).astype(np.int64)
    check_steady(time_ns, place)
    return time_ns


def _check_range(
    path: Path, columns: tuple[str, ...], current: NDArray[np.float64], full_power_current: float
) -> None:
    lowest, highest = _LOWEST_SHARE * full_power_current, _HIGHEST_SHARE * full_power_current
    bad = np.argwhere((current < lowest) | (current > highest))
    if bad.size:
        row, column = bad[0]
        raise InputError(
            f"{path.name}: line {row + 2}, column '{columns[column]}': found"
            f" '{current[row, column]:g}'; accepted: {lowest:g} to {highest:g}, as"
            f" irradiance.full_power_current is {full_power_current:g}"
        )
    largest = float(np.nanmax(current, initial=lowest))
    if 0.0 < largest < _FAINT_SHARE * full_power_current:
        raise InputError(
            f"{path.name}: the largest current is {largest:g}, which seems to be in another unit"
            f" than irradiance.full_power_current, {full_power_current:g}"
        )


def _means(
    path: Path,
    share: NDArray[np.float64],
    columns: tuple[str, ...],
    members: dict[str, list[_Combiner]],
    refuse_gaps: bool,
) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """Mean over the combiners of each inverter that has any, and what was missing."""
    means, report = {}, []
    for inverter, own in members.items():
        values = share[:, [columns.index(one.name) for one in own if one.name in columns]]
        total, there = len(own) * len(share), int(np.isfinite(values).sum())
        what = (
            f"{path.name}: inverter {inverter}: {total - there:,} of {total:,} currents of its"
            f" {len(own)} combiners missing"
        )
        if there < total and refuse_gaps:
            raise InputError(f"{what}; accepted with irradiance.gaps = 'refuse': none missing")
        if there == 0:
            report.append(f"{what}: left out, with its rating")
            continue
        if there < total:
            report.append(f"{what}: the mean is over those that are there")
        _check_never_silent(path, inverter, values)
        means[inverter] = np.nanmean(values, axis=1)
    if not means:
        raise InputError(f"{path.name}: no inverter has a current; accepted: at least one")
    return means, report


def _check_never_silent(path: Path, inverter: str, values: NDArray[np.float64]) -> None:
    """Refuse an inverter that is there at some times and not at others: it cannot come and go."""
    silent = np.flatnonzero(np.isnan(values).all(axis=1))
    if silent.size:
        raise InputError(
            f"{path.name}: line {silent[0] + 2}: no current of inverter {inverter}, and"
            f" {silent.size:,} such lines; accepted: some of its currents in each line, or none"
            " in all"
        )
