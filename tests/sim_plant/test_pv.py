"""From irradiance to AC power."""

import numpy as np
import pandas as pd
import pytest
from complaints import complaint_of
from pvlib import modelchain
from pvlib.location import Location
from pvlib.pvsystem import (
    AbstractMount,
    Array,
    FixedMount,
    PVSystem,
    SingleAxisTrackerMount,
)
from pvlib.temperature import TEMPERATURE_MODEL_PARAMETERS

from sim_plant.irradiance import Irradiance
from sim_plant.pv import PvSettings, ac_power_kw, check_night_is_dark
from sim_plant.sites import Sites
from sim_plant.sources import PlantUnderSky, measured_sky

LAT_DEG = np.array([21.31, 21.312])
LON_DEG = np.array([-158.08, -158.085])
RATING_KW = np.array([400.0, 500.0])
DAY = pd.date_range("2010-04-01 10:00", periods=24 * 60, freq="60s", tz="UTC")
MIDDLES = DAY + pd.Timedelta("30s")
"""Where the sun stands in each minute."""


def bell_wm2(peak_wm2: float) -> np.ndarray:
    """Irradiance of a made-up day at the site: light from 16:30 to 04:30 UTC."""
    hours = np.asarray((DAY - pd.Timestamp("2010-04-01 16:30", tz="UTC")).total_seconds()) / 3600
    one = peak_wm2 * np.clip(np.sin(np.pi * hours / 12.0), 0.0, None)
    return np.column_stack([one, 0.5 * one])


def power_kw(ghi_wm2: np.ndarray, settings: PvSettings) -> np.ndarray:
    return ac_power_kw(ghi_wm2, DAY, LAT_DEG, LON_DEG, RATING_KW, settings)


def test_a_flat_array_by_hand() -> None:
    # 1000 W/m2 at 20 degrees and no wind: Sandia's cell is at 20 + 1000 exp(-3.56) + 3 = 51.44
    # degrees, 26.44 above reference, so DC is 1 - 0.0035 * 26.44 of its rating.
    noon = pd.DatetimeIndex(["2010-04-01 22:30"], tz="UTC", freq="1s")
    found = ac_power_kw(
        np.array([[1000.0, 500.0]]), noon, LAT_DEG, LON_DEG, np.array([100.0, 100.0]), PvSettings()
    )
    dc_kw = 100.0 * (1.0 - 0.0035 * (20.0 + 1000.0 * np.exp(-3.56) + 3.0 - 25.0))
    load = dc_kw / (100.0 / 0.96)
    efficiency = 0.96 / 0.9637 * (-0.0162 * load - 0.0059 / load + 0.9858)
    assert found[0, 0] == pytest.approx(efficiency * dc_kw, rel=1e-12)
    assert found[0, 0] == pytest.approx(87.23, abs=0.005)


@pytest.mark.parametrize(
    "settings",
    [
        PvSettings(),
        PvSettings(tilt_deg=25.0, dc_ac_ratio=1.5),
        PvSettings(tilt_deg=30.0, azimuth_deg=90.0, temp_air_c=40.0, wind_speed_ms=8.0),
        PvSettings(tracker_gcr=0.4),
    ],
    ids=["flat", "clipped", "faces a warm windy morning", "trackers"],
)
def test_the_chain_is_that_of_pvlib(settings: PvSettings) -> None:
    ghi_wm2 = bell_wm2(1000.0)
    site = Location(float(LAT_DEG.mean()), float(LON_DEG.mean()))
    mount: AbstractMount = FixedMount(settings.tilt_deg, settings.azimuth_deg)
    if settings.tracker_gcr is not None:
        mount = SingleAxisTrackerMount(0.0, 180.0, max_angle=60.0, gcr=settings.tracker_gcr)
    array = Array(
        mount,
        module_parameters={"pdc0": settings.dc_ac_ratio * 400.0, "gamma_pdc": -0.0035},
        temperature_model_parameters=TEMPERATURE_MODEL_PARAMETERS["sapm"][
            "open_rack_glass_polymer"
        ],
    )
    system = PVSystem([array], inverter_parameters={"pdc0": 400.0 / 0.96, "eta_inv_nom": 0.96})
    chain = modelchain.ModelChain(
        system, site, aoi_model="no_loss", spectral_model="no_loss", losses_model="no_loss"
    )
    sun = site.get_solarposition(MIDDLES)
    sky = modelchain.pvlib.irradiance.erbs(ghi_wm2[:, 0], sun["zenith"], MIDDLES)
    air = {"temp_air": settings.temp_air_c, "wind_speed": settings.wind_speed_ms}
    light = {"ghi": ghi_wm2[:, 0], "dni": sky["dni"], "dhi": sky["dhi"]}
    chain.run_model(pd.DataFrame(light | air, index=MIDDLES))
    # The chain lifts the sun by refraction after GHI is split, which lets the beam on a flat array
    # differ a little from the GHI it came from when the sun is low.
    high = (sun["zenith"] < 80.0).to_numpy()
    expected_kw = chain.results.ac.to_numpy()[high]
    found_kw = power_kw(ghi_wm2, settings)[:, 0]
    np.testing.assert_allclose(found_kw[high], expected_kw, rtol=1e-2)
    assert found_kw.min() == 0.0
    assert (found_kw.max() == 400.0) == (settings.dc_ac_ratio == 1.5)


def test_no_power_while_the_sun_is_below_the_horizon() -> None:
    stray_light_wm2 = np.full((len(DAY), 2), 40.0)
    found = power_kw(stray_light_wm2, PvSettings())
    sun = Location(float(LAT_DEG.mean()), float(LON_DEG.mean())).get_solarposition(MIDDLES)
    up = (sun["apparent_zenith"] < 90.0).to_numpy()
    assert (found[~up] == 0.0).all()
    assert (found[up] > 0.0).all()


def test_the_sun_of_an_hourly_value_stands_where_it_is_in_the_middle_of_the_hour() -> None:
    """So a tilted array that faces south sees a day that is alike before and after noon."""
    noon = pd.Timestamp("2010-04-01 22:36", tz="UTC")  # The sun is highest there and then.
    hours = noon + pd.to_timedelta(np.arange(-4, 4), unit="h")
    ghi_wm2 = np.array([300.0, 500.0, 700.0, 800.0, 800.0, 700.0, 500.0, 300.0])[:, None]
    found = ac_power_kw(
        ghi_wm2, hours, LAT_DEG[:1], LON_DEG[:1], RATING_KW[:1], PvSettings(tilt_deg=40.0)
    )[:, 0]
    np.testing.assert_allclose(found, found[::-1], rtol=0.01)


def test_daylight_at_midnight_is_refused() -> None:
    ghi_wm2 = np.zeros((len(DAY), 2))
    ghi_wm2[0, 1] = 700.0
    found = complaint_of(check_night_is_dark, ghi_wm2, DAY, LAT_DEG, LON_DEG)
    assert "700.0 W/m2 at 2010-04-01T10:00:00" in found


@pytest.mark.parametrize("cycle_s", [1, 10, 60])
def test_the_power_around_a_run_is_that_of_the_whole_file(cycle_s: int) -> None:
    times = pd.date_range("2010-04-01 18:00", periods=3000, freq="10s", tz="UTC")
    ghi = pd.DataFrame(np.random.default_rng(3).uniform(0.0, 900.0, (3000, 2)), times, ["a", "b"])
    places = pd.DataFrame({"lat": LAT_DEG, "lon": LON_DEG}, ["a", "b"])
    sky = PlantUnderSky(Sites(("a", "b"), LAT_DEG, LON_DEG, RATING_KW), 0.0, PvSettings())
    irradiance = Irradiance(ghi, places, "ghi.csv")
    run = pd.date_range("2010-04-01 20:10", periods=120, freq=f"{cycle_s}s", tz="UTC")
    part, whole = measured_sky(sky, irradiance, run), measured_sky(sky, irradiance)
    assert len(part.measured_times) < len(whole.measured_times)
    np.testing.assert_allclose(part.available_kw(run), whole.available_kw(run))
    late = run + pd.Timedelta(hours=7)
    assert "2010-04-01T18:00" in complaint_of(
        measured_sky(sky, irradiance, late).available_kw, late
    )
