"""From irradiance to the AC power that each inverter could deliver.

The paper converts measured irradiance with pvlib and leaves air temperature and wind "in their
default state". Those defaults are pvlib's: where the weather has no such columns,
`pvlib.modelchain.ModelChain` takes 20 degrees Celsius and 0 m/s. The rest of the chain is that of
`ModelChain.with_pvwatts`, without its loss terms (incidence angle, spectrum, 14 % of system
losses): the rating of an inverter stands for its array after losses.
"""

from functools import lru_cache
from typing import Annotated

import msgspec
import numpy as np
import pandas as pd
from msgspec import Meta

from bus_schemas.errors import InputError
from sim_plant import Floats, imported_when_used
from sim_plant.time_steps import step_ns

pvlib = imported_when_used("pvlib")

# Daylight is over when the sun is 6 degrees below the horizon (civil twilight). A brighter value
# then means that the time stamp is in another time zone.
_TWILIGHT_ZENITH_DEG = 96.0
_TWILIGHT_MAX_WM2 = 50.0
_MOST_CHECKED = 10_000


class PvSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The arrays and inverters of the plant, all alike but for their rating.

    Defaults are pvlib's. It has none for `gamma_pdc_per_c`: -0.0035 is the "premium" crystalline
    module of PVWatts version 5 (doi:10.2172/1158421).

    tilt_deg: Tilt of the modules [degree]; at 0 POA irradiance is the GHI.
    azimuth_deg: Where the modules face, clockwise from north [degree].
    tracker_gcr: Ground coverage ratio of single-axis trackers from north to south, which follow the
        sun up to 60 degrees and backtrack, whatever tilt and azimuth say. Default: fixed modules.
    dc_ac_ratio: DC rating of an array over the AC rating of its inverter.
    temp_air_c: Air temperature [degree Celsius].
    wind_speed_ms: Wind speed at 10 m [m/s].
    gamma_pdc_per_c: Temperature coefficient of DC power [1/degree Celsius].
    inverter_efficiency: Nominal efficiency.
    albedo: Reflectance of the ground; without effect at tilt 0.
    """

    tilt_deg: Annotated[float, Meta(ge=0.0, le=90.0)] = 0.0
    azimuth_deg: Annotated[float, Meta(ge=0.0, le=360.0)] = 180.0
    tracker_gcr: Annotated[float, Meta(gt=0.0, le=1.0)] | None = None
    dc_ac_ratio: Annotated[float, Meta(gt=0.0, le=3.0)] = 1.0
    temp_air_c: Annotated[float, Meta(ge=-60.0, le=60.0)] = 20.0
    wind_speed_ms: Annotated[float, Meta(ge=0.0, le=60.0)] = 0.0
    gamma_pdc_per_c: Annotated[float, Meta(ge=-0.01, le=0.0)] = -0.0035
    inverter_efficiency: Annotated[float, Meta(gt=0.5, le=1.0)] = 0.96
    albedo: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.25


def ac_power_kw(
    ghi_wm2: Floats,
    times: pd.DatetimeIndex,
    lat_deg: Floats,
    lon_deg: Floats,
    rating_kw: Floats,
    settings: PvSettings,
) -> Floats:
    """Return the maximum AC power of each inverter at every time step.

    GHI is split into its beam and diffuse parts (Erbs, doi:10.1016/0038-092X(82)90302-4) and
    transposed to the plane of the array (Hay and Davies, the default of pvlib's ModelChain); the
    cell temperature follows the Sandia model for an open rack of glass-polymer modules, DC and AC
    power are those of PVWatts version 5 (doi:10.2172/1158421). The sun stands at one place for
    the whole plant: its position is computed once, at the centroid.

    Parameters
    ----------
    ghi_wm2 : numpy.ndarray, shape (T, N)
        Global horizontal irradiance at each inverter [W/m^2].
    times : pandas.DatetimeIndex, length T
        Beginnings of the steps, with a time zone. The sun stands where it is at their middle.
    lat_deg, lon_deg : numpy.ndarray, shape (N,)
        Coordinates of the inverters [degree], north and east positive.
    rating_kw : numpy.ndarray, shape (N,)
        AC rating of each inverter [kW], above 0.

    Returns
    -------
    numpy.ndarray, shape (T, N)
        AC power [kW], from 0 to the rating; 0 while the sun is below the horizon.
    """
    middle = times + pd.Timedelta(step_ns(times) // 2, unit="ns")
    middle_ns = middle.as_unit("ns").asi8.tobytes()
    sun = _sun_at(middle_ns, float(lat_deg.mean()), float(lon_deg.mean()))
    is_up = sun["apparent_zenith"].to_numpy()[:, None] < 90.0
    poa_wm2 = np.where(is_up, np.maximum(_poa_wm2(ghi_wm2, times, sun, settings), 0.0), 0.0)
    return _inverter_ac_kw(poa_wm2, rating_kw, settings)


@lru_cache(maxsize=2)  # For the run and for its past.
def _sun_at(times_ns: bytes, lat_deg: float, lon_deg: float) -> pd.DataFrame:
    times = pd.DatetimeIndex(np.frombuffer(times_ns, np.int64), tz="UTC")
    sun: pd.DataFrame = pvlib.solarposition.get_solarposition(times, lat_deg, lon_deg)
    return sun


def _poa_wm2(
    ghi_wm2: Floats, times: pd.DatetimeIndex, sun: pd.DataFrame, settings: PvSettings
) -> Floats:
    if settings.tilt_deg == 0.0 and settings.tracker_gcr is None:
        return ghi_wm2
    day = np.asarray(times.tz_convert("UTC").day_of_year)[:, None]
    part = pvlib.irradiance.erbs(ghi_wm2, sun["zenith"].to_numpy()[:, None], day)
    tilt_deg, azimuth_deg = _orientation(sun, settings)
    total = pvlib.irradiance.get_total_irradiance(
        tilt_deg,
        azimuth_deg,
        sun["apparent_zenith"].to_numpy()[:, None],
        sun["azimuth"].to_numpy()[:, None],
        dni=part["dni"],
        ghi=ghi_wm2,
        dhi=part["dhi"],
        dni_extra=pvlib.irradiance.get_extra_radiation(day),
        albedo=settings.albedo,
        model="haydavies",
    )
    return np.asarray(total["poa_global"], dtype=np.float64)


def _orientation(sun: pd.DataFrame, settings: PvSettings) -> tuple[Floats, Floats]:
    """Return tilt and azimuth of the modules [degree], of shape (T, 1) or single numbers."""
    if settings.tracker_gcr is None:
        return np.array(settings.tilt_deg), np.array(settings.azimuth_deg)
    tracker = pvlib.tracking.singleaxis(
        sun["apparent_zenith"],
        sun["azimuth"],
        axis_azimuth=180.0,
        max_angle=60.0,
        backtrack=True,
        gcr=settings.tracker_gcr,
    )
    # At night a tracker has no orientation.
    tilt_deg, azimuth_deg = (tracker[f"surface_{name}"].fillna(0.0) for name in ("tilt", "azimuth"))
    return tilt_deg.to_numpy()[:, None], azimuth_deg.to_numpy()[:, None]


def _inverter_ac_kw(poa_wm2: Floats, rating_kw: Floats, settings: PvSettings) -> Floats:
    module = pvlib.temperature.TEMPERATURE_MODEL_PARAMETERS["sapm"]["open_rack_glass_polymer"]
    weather = settings.temp_air_c, settings.wind_speed_ms
    cell_c = pvlib.temperature.sapm_cell(poa_wm2, *weather, **module)
    dc_rating_kw = rating_kw * settings.dc_ac_ratio
    dc_kw = pvlib.pvsystem.pvwatts_dc(poa_wm2, cell_c, dc_rating_kw, settings.gamma_pdc_per_c)
    # The AC rating of pvlib's inverter is its DC limit times its nominal efficiency.
    dc_limit_kw = rating_kw / settings.inverter_efficiency
    ac_kw = pvlib.inverter.pvwatts(dc_kw, dc_limit_kw, eta_inv_nom=settings.inverter_efficiency)
    return np.clip(np.asarray(ac_kw, dtype=np.float64), 0.0, rating_kw)


def check_night_is_dark(
    ghi_wm2: Floats, times: pd.DatetimeIndex, lat_deg: Floats, lon_deg: Floats
) -> None:
    """Refuse daylight at night; the parameters are those of `ac_power_kw`."""
    row_max_wm2 = ghi_wm2.max(axis=1)
    bright = np.flatnonzero(row_max_wm2 > _TWILIGHT_MAX_WM2)
    bright = bright[:: len(bright) // _MOST_CHECKED + 1]
    middles = times[bright] + pd.Timedelta(step_ns(times) // 2, unit="ns")
    sun = pvlib.solarposition.get_solarposition(middles, lat_deg.mean(), lon_deg.mean())
    zenith_deg = sun["zenith"].to_numpy()
    bad = np.flatnonzero(zenith_deg > _TWILIGHT_ZENITH_DEG)
    if bad.size:
        row = bright[bad[0]]
        raise InputError.of(
            "irradiance",
            "expected time stamps whose offset from UTC is right, and the coordinates "
            f"of the sensors, got {row_max_wm2[row]:.1f} W/m2 at {times[row].isoformat()} with the "
            f"sun {zenith_deg[bad[0]] - 90.0:.1f} degrees below the horizon",
        )
