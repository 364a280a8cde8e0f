"""Where a plant's available power comes from: a sky of clouds, or something that was measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import ClassVar, Final, TypeAlias

import numpy as np
import pandas as pd

from bus_schemas.errors import InputError
from sim_plant import Floats
from sim_plant.clouds import CloudSettings, clear_sky_ghi, synthetic_ghi
from sim_plant.irradiance import Irradiance
from sim_plant.kept import kept
from sim_plant.pv import PvSettings, ac_power_kw, check_night_is_dark
from sim_plant.sites import Sites
from sim_plant.time_steps import on_cycles

_ANOTHER_DAY: Final = 1_000_003
"""Added to a seed: the same climate on another day."""

_CLEAN_AIR_TURBIDITY: Final = 3.0
"""Linke turbidity of the clear sky where nothing better is known."""


@dataclass(frozen=True, slots=True)
class PlantUnderSky:
    """A plant whose power follows from the irradiance at its place."""

    sites: Sites
    altitude_m: float
    pv: PvSettings

    @property
    def place(self) -> tuple[Floats, Floats, float]:
        return self.sites.lat_deg, self.sites.lon_deg, self.altitude_m

    def power_kw(self, ghi_wm2: Floats, times: pd.DatetimeIndex) -> Floats:
        sites = self.sites
        return ac_power_kw(ghi_wm2, times, sites.lat_deg, sites.lon_deg, sites.rating_kw, self.pv)

    def cloudless_kw(self, times: pd.DatetimeIndex, turbidity: float) -> Floats:
        """Return the AC power of each inverter under a cloudless sky, shape (T, n)."""
        ghi_wm2 = clear_sky_ghi(times, *self.place, turbidity)
        return self.power_kw(np.repeat(ghi_wm2[:, None], len(self.sites.names), axis=1), times)


@dataclass(frozen=True, slots=True)
class CloudySky(PlantUnderSky):
    """A synthetic cloud field that drifts over the inverters.

    The irradiance of an inverter is the mean over a square block of its array, `block_m` wide.
    Earlier days have the scenario's seed, `history_seed`, whatever the run's own seed. The sky of
    the run is clear before `clear_until`. `is_kept`: what was worked out once is kept for later.
    """

    clouds: CloudSettings
    seed: int
    history_seed: int
    block_m: float = 0.0
    clear_until: pd.Timestamp | None = None
    is_kept: bool = False
    measured_times: ClassVar[None] = None  # Any time can be asked for.
    remarks: ClassVar[tuple[str, ...]] = ()

    def available_kw(self, times: pd.DatetimeIndex) -> Floats:
        cloudy_kw = self._drawn_kw(times, self.seed)
        if self.clear_until is None:
            return cloudy_kw
        clear_kw = self.cloudless_kw(times, self.clouds.linke_turbidity)
        return np.where((times < self.clear_until)[:, None], clear_kw, cloudy_kw)

    def earlier_day_kw(self, times: pd.DatetimeIndex) -> Floats:
        """Return the power under another day's clouds of the same climate, shape (T, n)."""
        return self._drawn_kw(times, self.history_seed + _ANOTHER_DAY)

    def kept_day_kw(self, times: pd.DatetimeIndex) -> Floats:
        """Return the same, which is kept whatever becomes of the run's own sky."""
        return replace(self, is_kept=True).earlier_day_kw(times)

    def clear_sky_kw(self, times: pd.DatetimeIndex) -> Floats:
        """Return the AC power of the whole plant under a cloudless sky, shape (T,)."""

        def total() -> Floats:
            return np.asarray(self.cloudless_kw(times, self.clouds.linke_turbidity).sum(axis=1))

        return self._kept(times, -1, total)

    def _drawn_kw(self, times: pd.DatetimeIndex, seed: int) -> Floats:
        def draw() -> Floats:
            ghi_wm2 = synthetic_ghi(times, *self.place, self.clouds, seed, self.block_m)
            return self.power_kw(ghi_wm2, times)

        return self._kept(times, seed, draw)

    def _kept(self, times: pd.DatetimeIndex, seed: int, work_out: Callable[[], Floats]) -> Floats:
        """Work out what the clouds of a seed leave of the power, or all of it (-1: no clouds)."""
        if not self.is_kept:
            return work_out()
        question = self.pv, self.clouds, self.block_m, *self.place, self.sites.rating_kw
        return kept(times, seed, *question, work_out=work_out)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlant:
    """Measured maximum power of a plant's inverters, shape (T, n).

    `source` is what was read, `repairs` say what was missing and how it was filled. `sky` is None
    where the plant's location is unknown. `earlier` is the same plant `earlier_by` before, if that
    was measured.
    """

    sites: Sites
    measured_times: pd.DatetimeIndex
    power_kw: Floats
    source: str
    repairs: tuple[str, ...] = ()
    sky: PlantUnderSky | None = None
    earlier: MeasuredPlant | None = None
    earlier_by: timedelta = timedelta(0)

    def available_kw(self, times: pd.DatetimeIndex) -> Floats:
        """Return the maximum AC power of each inverter in the cycles that begin at `times`."""
        return on_cycles(self.measured_times, self.power_kw, times, self.source)

    def earlier_day_kw(self, times: pd.DatetimeIndex) -> Floats:
        """Return what `available_kw` was at the same times of an earlier day, shape (T, n)."""
        if self.earlier is None:
            raise InputError.of("neighbours.history", "expected 'hindsight' with data of one day")
        return self.earlier.available_kw(times - self.earlier_by)

    def clear_sky_kw(self, times: pd.DatetimeIndex) -> Floats:
        if self.sky is None:
            raise InputError.of(
                "irradiance.lat, lon",
                "expected both, the place of the plant, since its commitment "
                "is a share of the clear-sky power",
            )
        return np.asarray(self.sky.cloudless_kw(times, _CLEAN_AIR_TURBIDITY).sum(axis=1))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was missing, also on the earlier day."""
        return self.repairs if self.earlier is None else self.repairs + self.earlier.repairs


def measured_sky(
    sky: PlantUnderSky, irradiance: Irradiance, wanted: pd.DatetimeIndex | None = None
) -> MeasuredPlant:
    """Return a plant with one inverter at each sensor of measured irradiance.

    Its power is worked out around the `wanted` times; by default at all.
    """
    sites, source, report = sky.sites, irradiance.source, irradiance.report
    ghi_wm2 = irradiance.ghi_wm2.to_numpy()
    check_night_is_dark(ghi_wm2, irradiance.times, sites.lat_deg, sites.lon_deg)
    part = irradiance if wanted is None else irradiance.around(wanted)
    power_kw = sky.power_kw(part.ghi_wm2.to_numpy(), part.times)
    return MeasuredPlant(sites, part.times, power_kw, source, report, sky)


PowerSource: TypeAlias = CloudySky | MeasuredPlant
"""The power that the sky allows a plant's inverters."""
