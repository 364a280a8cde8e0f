"""Where a plant's possible power comes from: a sky of clouds, or something that was measured."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta
from typing import Final, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bus_schemas.errors import InputError
from sim_plant.clouds import CloudSettings, clear_sky_ghi, synthetic_ghi
from sim_plant.irradiance import Irradiance
from sim_plant.pv import PvSettings, ac_power_kw
from sim_plant.sites import Sites
from sim_plant.time_steps import conversion, on_cycles

_ANOTHER_DAY: Final = 1_000_003
"""Added to a seed: the same climate on another day."""

_CLEAN_AIR_TURBIDITY: Final = 3.0
"""Linke turbidity of the clear sky where nothing better is known."""


class PowerSource(Protocol):
    """The power that the sky allows a plant's inverters."""

    @property
    def sites(self) -> Sites:
        """The inverters."""

    @property
    def measured_times(self) -> pd.DatetimeIndex | None:
        """All times of which there is a measurement; None where any time can be asked for."""

    def possible_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of each inverter at its maximum, shape (T, n)."""

    def clear_sky_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of the whole plant under a cloudless sky, shape (T,)."""

    def earlier_day_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return what `possible_kw` was at the same times of an earlier day, shape (T, n)."""

    def remarks(self, times: pd.DatetimeIndex) -> tuple[str, ...]:
        """Say what a reader of the run must know about the data, a line each."""


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

    @property
    def measured_times(self) -> None:
        """Any time can be asked for."""
        return

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

    def remarks(self, times: pd.DatetimeIndex) -> tuple[str, ...]:
        """Nothing: the sky is as it was asked for."""
        return ()

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
    repairs
        What was missing and how it was filled.
    earlier, earlier_by
        The same plant on an earlier day, if that was measured, and how long before.
    """

    sites: Sites
    altitude_m: float
    pv: PvSettings
    irradiance: Irradiance
    source: str
    repairs: tuple[str, ...] = ()
    earlier: MeasuredSky | None = None
    earlier_by: timedelta = timedelta(0)

    @property
    def measured_times(self) -> pd.DatetimeIndex:
        """All time stamps of the measurement."""
        return self.irradiance.times

    def possible_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of each inverter at its maximum, shape (T, n).

        It is worked out at the step of the measurement and brought to that of `times` as
        `on_cycles` says.

        Raises
        ------
        InputError
            The measurement does not cover the times, or their step does not fit its own.
        """
        return on_cycles(self.irradiance.times, self._power_kw, times, self.source)

    def earlier_day_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return what `possible_kw` was at the same times of an earlier day, shape (T, n).

        Raises
        ------
        InputError
            No earlier day was measured, or it does not cover the times.
        """
        if self.earlier is None:
            raise InputError(
                "neighbours.history: expected 'hindsight' with measurements of one day, got "
                "'earlier-day'"
            )
        return self.earlier.possible_kw(times - self.earlier_by)

    def clear_sky_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of the whole plant under a cloudless sky, shape (T,)."""
        return _clear_sky_kw(times, self.sites, self.altitude_m, self.pv, _CLEAN_AIR_TURBIDITY)

    def remarks(self, times: pd.DatetimeIndex) -> tuple[str, ...]:
        """Say what was filled, and how the measurement came to the times of the run."""
        history = self.earlier.repairs if self.earlier is not None else ()
        return (*self.repairs, *history, *_conversion(self.irradiance.times, times))

    def _power_kw(self, rows: slice) -> NDArray[np.float64]:
        data = self.irradiance
        return _ac_power_kw(data.ghi_wm2[rows], data.times[rows], self.sites, self.pv)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlant:
    """Power of a real plant's inverters, from measurements of their own.

    Attributes
    ----------
    sites
        The plant.
    times, power_kw
        Time stamps, and AC power of each inverter then, shape (T, n).
    source
        Where it was read from.
    repairs
        What was missing and what came of it.
    """

    sites: Sites
    times: pd.DatetimeIndex
    power_kw: NDArray[np.float64]
    source: str
    repairs: tuple[str, ...]

    @property
    def measured_times(self) -> pd.DatetimeIndex:
        """All time stamps of the measurement."""
        return self.times

    def possible_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Return the AC power of each inverter at its maximum, shape (T, n).

        Raises
        ------
        InputError
            The measurement does not cover the times, or their step does not fit its own.
        """
        return on_cycles(self.times, lambda rows: self.power_kw[rows], times, self.source)

    def earlier_day_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Refuse: there is no other day.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError(
            "neighbours.history: expected 'hindsight' with DC currents, got 'earlier-day'"
        )

    def clear_sky_kw(self, times: pd.DatetimeIndex) -> NDArray[np.float64]:
        """Refuse: nobody knows where the plant is.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError(
            "commitment.kind: expected 'constant', 'file', 'share-of-median' or 'below-possible' "
            "with DC currents, which have no date and place, got 'share-of-clear-sky'"
        )

    def remarks(self, times: pd.DatetimeIndex) -> tuple[str, ...]:
        """Say what was missing, and how the measurement came to the times of the run."""
        return (*self.repairs, *_conversion(self.times, times))


def _conversion(measured: pd.DatetimeIndex, times: pd.DatetimeIndex) -> tuple[str, ...]:
    said = conversion(measured, times)
    return () if said is None else (said,)


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
