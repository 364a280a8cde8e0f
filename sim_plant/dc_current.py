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

from bus_schemas.errors import InputError, listed
from bus_schemas.tree import check_name
from sim_plant import Floats
from sim_plant.csv_tables import CsvTable, read_csv
from sim_plant.sites import Sites, equal_ratings_kw, inverter_names, placed_around
from sim_plant.sources import MeasuredPlant

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
    place: tuple[float, float] | None = None,
) -> MeasuredPlant:
    """Read the currents of combiners; an inverter's power is their mean, clipped at full power.

    `currents_csv` has the column `t_s`, seconds since `begins` with a constant step, and one column
    for each combiner; a field may be empty. `positions_csv` has the columns `combiner, inverter,
    x_m, y_m`, metres east and north of an arbitrary point.

    If some combiners of an inverter are missing, the mean is over the others. An inverter without
    any current is left out, with its rating; all currents of another must not be missing at once.
    The middle of the plant stands at `place`, latitude and longitude; one whose place is unknown on
    the equator, at any longitude.
    """
    table = read_csv(currents_csv, ("t_s",))
    combiners = _read_combiners(positions_csv)
    columns = [name for name in table.value_columns if name and name != "t_s"]
    if not columns:
        raise InputError(f"{table.name}: line 1: expected t_s and a column for each combiner")
    if unknown := [name for name in columns if name not in combiners.index]:
        raise InputError(
            f"{positions_csv.name}: expected a line for each combiner of {table.name}, got none "
            f"for {listed(unknown)}"
        )
    table, time_ns = table.steady("t_s", table.seconds_ns("t_s"))
    current = _currents(table, columns, full_power_current)
    # Combiners of the positions file that the currents lack are missing throughout.
    share = pd.DataFrame(np.maximum(current / full_power_current, 0.0), columns=columns)
    share = share.reindex(columns=combiners.index)
    means, report = _means(table.name, share, combiners["inverter"])
    times = begins + pd.to_timedelta(time_ns, unit="ns")
    positions = combiners.groupby("inverter", sort=False)[["x_m", "y_m"]].mean()
    x_m, y_m = positions.loc[means.columns].to_numpy().T
    rating_kw = equal_ratings_kw(plant_rating_kw, len(positions), "plant")[: len(x_m)]
    names = inverter_names(map(str, means))
    return MeasuredPlant(
        Sites(names, *placed_around(place or (0.0, 0.0), x_m, y_m), rating_kw),
        times,
        np.minimum(np.ascontiguousarray(means), 1.0) * rating_kw,
        str(currents_csv),
        table.said() + tuple(report),
    )


def _read_combiners(path: Path) -> pd.DataFrame:
    """Return inverter and position of each combiner, indexed by its name."""
    needed = ("combiner", "inverter", "x_m", "y_m")
    table = read_csv(path, needed, texts=needed[:2])
    names, inverters = table.unique_names("combiner"), tuple(table.text("inverter"))
    for inverter in inverters:
        check_name(inverter, path.name)
    expected = f"metres from -{_FURTHEST_M:.0f} to {_FURTHEST_M:.0f}"
    x_m, y_m = table.numbers(("x_m", "y_m"), expected, -_FURTHEST_M, _FURTHEST_M).T
    return pd.DataFrame({"inverter": inverters, "x_m": x_m, "y_m": y_m}, index=list(names))


def _currents(table: CsvTable, columns: list[str], full_power_current: float) -> Floats:
    lowest, highest = _LOWEST_SHARE * full_power_current, _HIGHEST_SHARE * full_power_current
    unit = f"irradiance.full_power_current is {full_power_current:g}"
    expected = f"{lowest:g} to {highest:g}, as {unit}, or nothing"
    current = table.numbers(
        columns, expected, lowest, highest, empty_is_missing=True, sentinels=True
    )
    largest = float(np.nanmax(current, initial=lowest))
    if 0.0 < largest < _FAINT_SHARE * full_power_current:
        raise InputError(
            f"{table.name}: expected larger currents, as {unit}, got at most {largest:g}"
        )
    return current


def _means(
    name: str, share: pd.DataFrame, inverter_of: pd.Series
) -> tuple[pd.DataFrame, list[str]]:
    """Return the mean of each inverter that has currents, and lines on what was missing."""
    found, report = {}, []
    for inverter in inverter_of.unique():
        shares = share.loc[:, inverter_of == inverter]
        missing, total = int(shares.isna().to_numpy().sum()), shares.size
        if missing < total:
            found[inverter] = shares.mean(axis=1)
        if missing:
            done = "the mean is over the others" if missing < total else "left out, with its rating"
            report.append(
                f"{name}: inverter {inverter}: {missing:,} of {total:,} currents of its "
                f"{shares.shape[1]} combiners missing: {done}"
            )
    means = pd.DataFrame(found)
    incomplete = list(means.columns[means.isna().any()])
    if means.empty or incomplete:
        raise InputError(
            f"{name}: expected currents of an inverter in every line or in none, got lines without "
            f"for {listed(incomplete) or 'all'}"
        )
    return means, report
