"""The synthetic clouds: their statistics, their drift and that they can be repeated."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sim_plant import Floats, clouds
from sim_plant.clouds import CloudSettings, clear_sky_ghi, synthetic_ghi
from sim_plant.irradiance import read_measured_ghi

# A made-up plant of 12 sensors over one kilometre, near the airport of the paper.
_PLACES = np.random.default_rng(12).random((12, 2))
LAT_DEG = 21.31 + 0.009 * _PLACES[:, 0]
LON_DEG = -158.085 + 0.0097 * _PLACES[:, 1]


def instants(start: str, count: int) -> pd.DatetimeIndex:
    return pd.date_range(start, periods=count, freq="1s")


def clear_sky_index(times: pd.DatetimeIndex, settings: CloudSettings, seed: int = 1) -> Floats:
    ghi_wm2 = synthetic_ghi(times, LAT_DEG, LON_DEG, 5.0, settings, seed)
    clear_wm2 = clear_sky_ghi(times, LAT_DEG, LON_DEG, 5.0, settings.linke_turbidity)
    return np.asarray(ghi_wm2 / clear_wm2[:, None])


NOON = instants("2010-04-01T19:00Z", 4 * 3600)


@pytest.fixture(scope="module")
def noon_index() -> Floats:
    return clear_sky_index(NOON, CloudSettings())


def changes(index: Floats, interval_s: int) -> Floats:
    """Return the changes within an interval, from each second on."""
    return np.asarray(index[interval_s:] - index[:-interval_s])


def test_the_clear_sky_is_pvlibs_at_noon_and_dark_at_night() -> None:
    times = pd.DatetimeIndex(["2010-04-01T22:34Z", "2010-04-01T10:00Z"])
    noon, night = clear_sky_ghi(times, LAT_DEG, LON_DEG, 5.0, 3.0)
    assert 1000.0 < noon < 1050.0
    assert night == 0.0
    assert not synthetic_ghi(times[1:], LAT_DEG, LON_DEG, 5.0, CloudSettings(), 1).any()


def test_the_weather_does_not_depend_on_where_the_run_begins(noon_index: Floats) -> None:
    later = NOON[3601:3661]
    np.testing.assert_allclose(
        clear_sky_index(later, CloudSettings()), noon_index[3601:3661], rtol=1e-12
    )


@pytest.mark.parametrize(
    ("from_deg", "east_m", "north_m"), [(270.0, 600.0, 0.0), (0.0, 0.0, -600.0)]
)
def test_clouds_drift_with_the_wind(from_deg: float, east_m: float, north_m: float) -> None:
    wind = CloudSettings(drift_speed_ms=10.0, drift_from_deg=from_deg, evolution_s=86_400)
    time_s = np.arange(0.0, 7200.0, 10.0)
    places = np.array([0.0, east_m]), np.array([0.0, north_m])
    here, there = clouds.clear_sky_index(time_s, *places, wind, 1).T
    assert np.corrcoef(here[:-6], there[6:])[0, 1] > 0.99, "600 m at 10 m/s take 60 s"
    assert np.corrcoef(here, there)[0, 1] < 0.9


def test_the_sky_does_not_come_back_when_its_pieces_have_been_blended_through() -> None:
    still = CloudSettings(drift_speed_ms=0.0, evolution_s=60.0)
    index = clear_sky_index(instants("2010-04-01T18:00Z", 6 * 3600), still)
    lags = np.arange(120, 3600, 30)
    alike = [np.corrcoef(index[:-lag, 0], index[lag:, 0])[0, 1] for lag in lags]
    assert np.abs(alike).max() < 0.3


@pytest.mark.parametrize("cloud_cover", [0.2, 0.8])
def test_the_share_of_covered_sky_is_the_one_asked_for(cloud_cover: float) -> None:
    # A cloud without scattered light: at its edge the index has begun to fall.
    settings = CloudSettings(cloud_cover=cloud_cover, edge_enhancement=1.0, drift_speed_ms=40.0)
    edge = 0.4 + 0.6 * np.exp(-0.08 * np.log1p(np.exp(0.3 / 0.08)))
    time_s = np.arange(0.0, 100 * 3600.0, 30.0)
    index = clouds.clear_sky_index(time_s, np.zeros(1), np.zeros(1), settings, 2)
    assert np.mean(index < edge) == pytest.approx(cloud_cover, abs=0.03)


def test_no_cloud_is_a_clear_sky_and_full_cover_is_thick_cloud() -> None:
    times = instants("2010-04-01T22:00Z", 30)
    np.testing.assert_allclose(clear_sky_index(times, CloudSettings(cloud_cover=0.0)), 1.0)
    np.testing.assert_allclose(clear_sky_index(times, CloudSettings(cloud_cover=1.0)), 0.4)


def test_over_a_block_of_modules_clouds_are_averaged(noon_index: Floats) -> None:
    settings, place = CloudSettings(), (LAT_DEG, LON_DEG, 5.0)
    clear_wm2 = clear_sky_ghi(NOON, *place, settings.linke_turbidity)[:, None]
    blocks = np.asarray(synthetic_ghi(NOON, *place, settings, 1, block_m=200.0) / clear_wm2)
    assert blocks.mean() == pytest.approx(noon_index.mean(), abs=0.01)
    fastest = [np.quantile(np.abs(changes(index, 1)), 0.99) for index in (blocks, noon_index)]
    assert fastest[0] < 0.6 * fastest[1]
    # Of a small block the middle is nearly the mean.
    tiny = np.asarray(synthetic_ghi(NOON, *place, settings, 1, block_m=0.1) / clear_wm2)
    np.testing.assert_allclose(tiny, noon_index, atol=1e-3)


def test_changes_are_those_of_measurements(data_folder: Path) -> None:
    """The set that most constants were set by: same places, step, cover and speed."""
    folder = data_folder / "hope-melpitz-1s"
    read = read_measured_ghi(folder / "ghi_20130908_0915_0955.csv", folder / "positions.csv")
    table = pd.read_csv(folder / "positions.csv", dtype={"station": str}).set_index("station")
    east_m, north_m = table.loc[list(read.sensors), ["x_m", "y_m"]].to_numpy(dtype=np.float64).T
    settings = CloudSettings(cloud_cover=0.87, drift_speed_ms=19.3)
    measured = read.ghi_wm2.to_numpy()
    time_s = np.arange(float(len(measured)))
    synthetic = clouds.clear_sky_index(time_s, east_m, north_m, settings, 1)
    # HOPE has values above what reaches the atmosphere: a high quantile stands for a clear sky.
    skies = [sky / np.quantile(sky, 0.95, axis=0) for sky in (measured, synthetic)]
    for interval_s in (1, 10, 30):
        of_measured, of_synthetic = (
            np.quantile(np.abs(changes(np.asarray(sky), interval_s)), 0.99) for sky in skies
        )
        assert 0.75 < of_synthetic / of_measured < 1.5
