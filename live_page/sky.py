"""The clouds over a plant whose sky is synthetic, as a coarse field to draw behind its map."""

from __future__ import annotations

from typing import Any, Final

import msgspec
import numpy as np
import pandas as pd

from bus_schemas.errors import InputError
from recordings.read.reader import RunReader
from scenarios.scenario import CloudIrradiance
from sim_plant.clouds import clear_sky_index

_CELLS: Final = 40
"""Points along the longer side."""

_MARGIN: Final = 0.12
"""Share of the longer side that is drawn around the inverters."""


def clouds(run: RunReader, cycle: int) -> dict[str, Any]:
    """Return the clouds of a cycle: how much of the sunlight is missing, in %, from north to south.

    `west_m`, `north_m` and `cell_m` say where they are, in the metres of the plan's positions.

    Raises InputError: The run has no synthetic sky, or no positions of its inverters.
    """
    plan, table = run.plan, run.scenario_table().get("irradiance", {})
    if table.get("kind") != "clouds" or not plan.site.positions_m:
        raise InputError("clouds: expected a run with synthetic clouds and known positions")
    sky = msgspec.convert(table, CloudIrradiance)
    positions = np.array(plan.site.positions_m)
    low, high = positions.min(axis=0), positions.max(axis=0)
    margin_m = max(float((high - low).max()) * _MARGIN, 1.0)
    (width_m, height_m), (west_m, north_m) = high - low + 2 * margin_m, (low[0], high[1])
    cell_m = max(width_m, height_m) / _CELLS
    columns, rows = int(np.ceil(width_m / cell_m)), int(np.ceil(height_m / cell_m))
    west_m, north_m = west_m - margin_m, north_m + margin_m
    east, north = np.meshgrid(
        west_m + cell_m * (np.arange(columns) + 0.5), north_m - cell_m * (np.arange(rows) + 0.5)
    )
    now_ns = plan.timing.sim_time_ns(cycle)
    index = clear_sky_index(
        np.array([now_ns / 1e9]), east.ravel(), north.ravel(), sky.clouds, plan.site.seed or 0
    )
    lost = np.clip(1.0 - index, 0.0, 1.0)
    if sky.clear_until is not None:
        clear_until = pd.Timestamp(sky.clear_until)
        if clear_until.tz is None:
            clear_until = clear_until.tz_localize(plan.timing.timezone)
        lost *= now_ns >= clear_until.value
    values = np.rint(100.0 * lost).astype(int).ravel().tolist()
    place = {"west_m": float(west_m), "north_m": float(north_m), "cell_m": float(cell_m)}
    return {"cycle": cycle, "columns": columns, "rows": rows, "values": values, **place}
