"""DC currents of a real plant's combiner boxes, and the AC power of its inverters that they mean.

Plants publish currents without units, as a share of something unstated. Here an inverter whose
combiners carry `full_power_current` on average is at its rating, and delivers no more however
bright it is. That current is a convention of the scenario, not a property of the plant.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from bus_schemas.errors import InputError
from bus_schemas.tree import check_name, some_of
from sim_plant import Floats
from sim_plant.csv_tables import CsvTable, read_csv
from sim_plant.positions import placed_on_the_equator
from sim_plant.sites import Sites, equal_ratings_kw, inverter_name
from sim_plant.sources import MeasuredPlant

TIME_COLUMN: Final = "t_s"

# Sensors at rest read a little off zero; the brightest edge of a cloud does not double the sun.
_LOWEST_SHARE: Final = -0.02
_HIGHEST_SHARE: Final = 2.0
# A share of 1 in a file where percent are expected, or the other way round, is off by 100.
_FAINT_SHARE: Final = 0.02

_FURTHEST_M: Final = 1e6


def read_currents(
    currents_csv: Path,
    positions_csv: Path,
    full_power_current: float,
    begins: pd.Timestamp,
    plant_rating_kw: float | None,
    *,
    refuse_gaps: bool,
) -> MeasuredPlant:
    """Read the currents of combiners; an inverter's power is their mean, clipped at full power.

    `currents_csv` has the column `t_s`, seconds since `begins` with a constant step, and one column
    for each combiner; a field may be empty. `positions_csv` has the columns `combiner, inverter,
    x_m, y_m`, metres east and north of an arbitrary point.

    If some combiners of an inverter are missing, the mean is over the others. An inverter without
    any current is left out, with its rating. If `refuse_gaps`, a missing value is an error instead.
    """
    table = read_csv(currents_csv)
    combiners = _read_combiners(positions_csv)
    columns = _columns(table, combiners.index, positions_csv)
    current = _currents(table, columns, full_power_current, refuse_gaps)
    # Combiners of the positions file that the currents lack are missing throughout.
    share = pd.DataFrame(np.maximum(current / full_power_current, 0.0), columns=list(columns))
    share = share.reindex(columns=combiners.index)
    means, report = _means(table.name, share, combiners["inverter"], refuse_gaps)
    positions = combiners.groupby("inverter", sort=False)[["x_m", "y_m"]].mean()
    x_m, y_m = positions.loc[means.columns].to_numpy().T
    rating_kw = equal_ratings_kw(plant_rating_kw, len(positions), "plant")[: len(x_m)]
    names = tuple(inverter_name(str(inverter)) for inverter in means)
    return MeasuredPlant(
        Sites(names, *placed_on_the_equator(x_m, y_m), rating_kw),
        begins + pd.to_timedelta(table.seconds_ns(TIME_COLUMN), unit="ns"),
        np.minimum(np.ascontiguousarray(means), 1.0) * rating_kw,
        str(currents_csv),
        tuple(report),
    )


def _read_combiners(path: Path) -> pd.DataFrame:
    """Return inverter and position of each combiner, indexed by its name."""
    table = read_csv(path)
    table.check_header(("combiner", "inverter", "x_m", "y_m"))
    names, inverters = table.unique_names("combiner"), table.names("inverter")
    for row, inverter in enumerate(inverters):
        check_name(inverter, f"{path.name}: line {row + 2}")
    expected = f"metres from -{_FURTHEST_M:.0f} to {_FURTHEST_M:.0f}"
    x_m, y_m = table.numbers(("x_m", "y_m"), expected, -_FURTHEST_M, _FURTHEST_M).T
    return pd.DataFrame({"inverter": inverters, "x_m": x_m, "y_m": y_m}, index=list(names))


def _columns(table: CsvTable, combiners: pd.Index, positions: Path) -> tuple[str, ...]:
    first, *columns = table.header
    if first != TIME_COLUMN or not columns:
        raise InputError(
            f"{table.name}: line 1: expected {TIME_COLUMN}, then a column for each combiner, got "
            f"{some_of(table.header)}"
        )
    table.check_no_column_twice()
    if unknown := [name for name in columns if name not in combiners]:
        raise InputError(
            f"{positions.name}: expected a line for each combiner of {table.name}, got none for "
            f"{some_of(unknown)}"
        )
    return tuple(columns)


def _currents(
    table: CsvTable, columns: tuple[str, ...], full_power_current: float, refuse_gaps: bool
) -> Floats:
    lowest, highest = _LOWEST_SHARE * full_power_current, _HIGHEST_SHARE * full_power_current
    expected = (
        f"{lowest:g} to {highest:g}, as irradiance.full_power_current is {full_power_current:g}, "
        + ("and none missing, as irradiance.gaps is 'refuse'" if refuse_gaps else "or nothing")
    )
    current = table.numbers(columns, expected, lowest, highest, empty_is_missing=not refuse_gaps)
    largest = float(np.nanmax(current, initial=lowest))
    if 0.0 < largest < _FAINT_SHARE * full_power_current:
        raise InputError(
            f"{table.name}: expected currents in the unit of irradiance.full_power_current, "
            f"{full_power_current:g}, got at most {largest:g}"
        )
    return current


def _means(
    name: str, share: pd.DataFrame, inverter_of: pd.Series, refuse_gaps: bool
) -> tuple[pd.DataFrame, list[str]]:
    """Return the mean of each inverter that has currents, and lines on what was missing."""
    own = {inverter: share.loc[:, inverter_of == inverter] for inverter in inverter_of.unique()}
    report = []
    for inverter, shares in own.items():
        missing, total = int(shares.isna().to_numpy().sum()), shares.size
        if not missing:
            continue
        what = (
            f"{name}: inverter {inverter}: {missing:,} of {total:,} currents of its "
            f"{shares.shape[1]} combiners missing"
        )
        if refuse_gaps:
            raise InputError(f"{what}, expected none, as irradiance.gaps is 'refuse'")
        done = "the mean is over the others" if missing < total else "left out, with its rating"
        report.append(f"{what}: {done}")
    means = pd.DataFrame({inverter: shares.mean(axis=1) for inverter, shares in own.items()})
    means = means.dropna(axis="columns", how="all")
    if means.empty:
        raise InputError(f"{name}: expected at least one inverter with a current, got none")
    silent = np.argwhere(means.isna())
    if silent.size:
        row, place = silent[0]
        raise InputError(
            f"{name}: line {row + 2}: expected a current of inverter {means.columns[place]} in "
            f"every line or in none, got {len(silent):,} lines without"
        )
    return means, report
