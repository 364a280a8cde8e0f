"""Where a plant's possible power comes from: a sky of clouds, or measured irradiance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bus_schemas.errors import InputError
from sim_plant.clouds import CloudSettings, clear_sky_ghi, synthetic_ghi
from sim_plant.irradiance import Irradiance, window
from sim_plant.pv import PvSettings, ac_power_kw
from sim_plant.sites import Sites

_ANOTHER_DAY: Final = 1_000_003
"""Added to a seed: the same climate on another day."""

_CLEAN_AIR_TURBIDITY: Final = 3.0
"""Linke turbidity of the clear sky where nothing better is known."""


class PowerSource(Protocol):
    """The power that the sky allows a plant's inverters."""

    @property
    def sites(self) -> Sites:
        """The inverters."""

    def possible_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of each inverter at its maximum, shape (T, n)."""

    def clear_sky_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of the whole plant under a cloudless sky, shape (T,)."""

    def earlier_day_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return what `possible_kw` was at the same times of an earlier day, shape (T, n)."""


@dataclass(frozen=True, slots=True)
class CloudySky:
    """A synthetic cloud field that drifts over the inverters.

    Attributes
    ----------
    sites, altitude_m, pv
        The plant.
    clouds, seed
        The sky of the run.
    history_seed
        Seed of the scenario: earlier days stay the same whatever the run's own seed.
    """

    sites: Sites
    altitude_m: float
    pv: PvSettings
    clouds: CloudSettings
    seed: int
    history_seed: int

    def possible_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of each inverter at its maximum, shape (T, n)."""
        return self._power_kw(times, self.seed)

    def earlier_day_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the power under another day's clouds of the same climate, shape (T, n)."""
        return self._power_kw(times, self.history_seed + _ANOTHER_DAY)

    def clear_sky_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of the whole plant under a cloudless sky, shape (T,)."""
        return _clear_sky_kw(
            times, self.sites, self.altitude_m, self.pv, self.clouds.linke_turbidity
        )

    def _power_kw(self, times: pd.DatetimeIndex, seed: int) -> NDArray[np.float64]:
        sites = self.sites
        ghi_wm2 = synthetic_ghi(
            times, sites.lat_deg, sites.lon_deg, self.altitude_m, self.clouds, seed
        )
        return _ac_power_kw(ghi_wm2, times, sites, self.pv)


@dataclass(frozen=True, slots=True)
class MeasuredSky:
    """Irradiance as it was measured, one inverter at each sensor.

    Attributes
    ----------
    sites, altitude_m, pv
        The plant.
    irradiance
        The whole measurement.
    source
        Where it was read from.
    """

    sites: Sites
    altitude_m: float
    pv: PvSettings
    irradiance: Irradiance
    source: str

    def possible_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of each inverter at its maximum, shape (T, n).

        Raises
        ------
        InputError
            The measurement does not cover the times, or has another step.
        """
        step_s = _step_s(times) if len(times) > 1 else _step_s(self.irradiance.times)
        if step_s != _step_s(self.irradiance.times):
            raise InputError(
                f"{self.source}: a value every {_step_s(self.irradiance.times):g} s, accepted is "
                f"the scenario's cycle, {step_s:g} s"
            )
        cut = window(self.irradiance, times[0], len(times) * step_s, self.source)
        return _ac_power_kw(cut.ghi_wm2, times, self.sites, self.pv)

    def earlier_day_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Refuse: there is no other day.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError(
            "neighbours.history is 'earlier-day', accepted with measured irradiance is 'hindsight'"
        )

    def clear_sky_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of the whole plant under a cloudless sky, shape (T,)."""
        return _clear_sky_kw(times, self.sites, self.altitude_m, self.pv, _CLEAN_AIR_TURBIDITY)


def _ac_power_kw(
    ghi_wm2: NDArray[np.float64], times: pd.DatetimeIndex, sites: Sites, pv: PvSettings
) -> NDArray[np.float64]:
    return ac_power_kw(ghi_wm2, times, sites.lat_deg, sites.lon_deg, sites.rating_kw, pv)


def _clear_sky_kw(
    times: pd.DatetimeIndex, sites: Sites, altitude_m: float, pv: PvSettings, turbidity: float
) -> NDArray[np.float64]:
    ghi_wm2 = clear_sky_ghi(times, sites.lat_deg, sites.lon_deg, altitude_m, turbidity)
    everywhere = np.repeat(ghi_wm2[:, None], len(sites.names), axis=1)
    total_kw: NDArray[np.float64] = _ac_power_kw(everywhere, times, sites, pv).sum(axis=1)
    return total_kw


def _step_s(times: pd.DatetimeIndex) -> float:
    return float((times[1] - times[0]).total_seconds())
