"""What each plant of a fleet gave at its own meter, beside its share of what was wanted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import msgspec
import numpy as np

from recordings.read.series import RunSeries
from results.tables import Column, Table, attributes, key_column


class PlantFigures(msgspec.Struct, frozen=True):
    """A plant of a fleet in a run.

    rating_kw: Its export limit.
    above_kwh, below_kwh: What it gave beyond its share of what was wanted, and what it lacked.
    highest_kw: The most that its meter showed.
    """

    name: str
    rating_kw: float
    available_kwh: float
    delivered_kwh: float
    above_kwh: float
    below_kwh: float
    highest_kw: float


_COLUMNS: Final = (
    key_column("plant", "name"),
    Column("rating", "kW", 0, name="rating_kw"),
    Column("available", "kWh", 1, name="available_kwh"),
    Column("delivered", "kWh", 2, name="delivered_kwh"),
    Column("above its share", "kWh", 2, name="above_kwh"),
    Column("below its share", "kWh", 2, name="below_kwh"),
    Column("highest", "kW", 1, name="highest_kw"),
)


def plant_figures(series: RunSeries) -> Iterator[PlantFigures]:
    """Yield what each plant of a fleet gave; nothing where the run has one plant alone."""
    tree, meters, known = series.plan.tree, series.meters, series.known
    hours, wanted_kw = series.cycle_s / 3600.0, series.desired_kw[known]
    for name in meters.plants:
        rating_kw = tree.rating_kw(name)
        fed_in_kw = meters.plant_kw(name, series.power_kw, series.storage_power_kw)[known]
        could_kw = np.minimum(meters.plant_kw(name, series.mpp_kw)[known], rating_kw)
        beyond_kw = fed_in_kw - wanted_kw * (rating_kw / series.rating_kw)
        yield PlantFigures(
            name,
            rating_kw,
            available_kwh=float(could_kw.sum()) * hours,
            delivered_kwh=float(fed_in_kw.sum()) * hours,
            above_kwh=float(np.maximum(beyond_kw, 0.0).sum()) * hours,
            below_kwh=float(np.maximum(-beyond_kw, 0.0).sum()) * hours,
            highest_kw=float(fed_in_kw.max()) if fed_in_kw.size else 0.0,
        )


def plants_tables(plants: Sequence[PlantFigures]) -> Iterator[Table]:
    """Yield their table, if there are some."""
    if plants:
        yield Table("Plants, each at its own meter", _COLUMNS, attributes(plants, _COLUMNS))
