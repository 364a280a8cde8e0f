"""The synthetic clouds: their statistics, their drift and that they can be repeated."""

import os
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from sim_plant.clouds import CloudSettings, clear_sky_ghi, synthetic_ghi
from sim_plant.irradiance import read_measured_ghi

# A made-up plant of 12 sensors over one kilometre, near the airport of the paper.
_PLACES = np.random.default_rng(12).random((12, 2))
LAT_DEG = 21.31 + 0.009 * _PLACES[:, 0]
LON_DEG = -158.085 + 0.0097 * _PLACES[:, 1]
METRE_DEG = 1.0 / 111_194.93


def instants(start: str, count: int) -> pd.DatetimeIndex:
    return pd.date_range(start, periods=count, freq="1s")


def clear_sky_index(
    times: pd.DatetimeIndex, settings: CloudSettings, seed: int = 1
) -> NDArray[np.float64]:
    ghi_wm2 = synthetic_ghi(times, LAT_DEG, LON_DEG, 5.0, settings, seed)
    clear_wm2 = clear_sky_ghi(times, LAT_DEG, LON_DEG, 5.0, settings.linke_turbidity)
    return np.asarray(ghi_wm2 / clear_wm2[:, None])


NOON = instants("2010-04-01T19:00Z", 4 * 3600)


@pytest.fixture(scope="module")
def noon_index() -> NDArray[np.float64]:
    return clear_sky_index(NOON, CloudSettings())


def change(series: NDArray[np.float64], lag: int) -> NDArray[np.float64]:
    return np.asarray(series[lag:] - series[:-lag])


def distances_m(lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    north = lat_deg / METRE_DEG
    east = lon_deg / METRE_DEG * np.cos(np.deg2rad(lat_deg.mean()))
    return np.asarray(np.hypot(north[:, None] - north, east[:, None] - east))


def correlation_by_distance(
    index: NDArray[np.float64], distance_m: NDArray[np.float64], limits_m: tuple[int, ...]
) -> list[float]:
    """Median correlation of 30 s changes of the pairs in each class of distance."""
    correlation = np.asarray(np.corrcoef(change(index, 30).T))
    upper = np.triu(np.ones(distance_m.shape, dtype=bool), k=1)
    return [
        float(np.median(correlation[upper & (distance_m >= low) & (distance_m < high)]))
        for low, high in pairwise(limits_m)
    ]


def test_the_clear_sky_is_pvlibs_at_noon_and_dark_at_night() -> None:
    times = pd.DatetimeIndex(["2010-04-01T22:34Z", "2010-04-01T10:00Z"])
    noon, night = clear_sky_ghi(times, LAT_DEG, LON_DEG, 5.0, 3.0)
    assert 1000.0 < noon < 1050.0
    assert night == 0.0


def test_the_same_arguments_give_the_same_weather_to_the_last_bit() -> None:
    times = instants("2010-04-01T22:00Z", 60)
    first = synthetic_ghi(times, LAT_DEG, LON_DEG, 5.0, CloudSettings(), 7)
    again = synthetic_ghi(times, LAT_DEG, LON_DEG, 5.0, CloudSettings(), 7)
    other = synthetic_ghi(times, LAT_DEG, LON_DEG, 5.0, CloudSettings(), 8)
    assert first.tobytes() == again.tobytes()
    assert not np.allclose(first, other)


def test_the_weather_at_an_instant_does_not_depend_on_where_the_run_begins(
    noon_index: NDArray[np.float64],
) -> None:
    later = NOON[3601:3661]
    np.testing.assert_allclose(
        clear_sky_index(later, CloudSettings()), noon_index[3601:3661], rtol=1e-12
    )


def test_the_weather_at_an_instant_does_not_depend_on_the_time_zone_it_is_told_in() -> None:
    times = instants("2010-04-01T22:00Z", 5)
    local = times.tz_convert("Pacific/Honolulu")
    settings = CloudSettings()
    np.testing.assert_array_equal(
        synthetic_ghi(times, LAT_DEG, LON_DEG, 5.0, settings, 1),
        synthetic_ghi(local, LAT_DEG, LON_DEG, 5.0, settings, 1),
    )


@pytest.mark.parametrize("drift_from_deg", [0.0, 65.0, 90.0, 200.0])
def test_a_sensor_down_wind_sees_the_same_cloud_later(drift_from_deg: float) -> None:
    settings = CloudSettings(drift_from_deg=drift_from_deg, drift_speed_ms=10.0, evolution_s=86_400)
    # 500 m towards where the clouds go: 50 s at 10 m/s.
    towards = np.deg2rad(drift_from_deg + 180.0)
    lat_deg = 21.3 + np.array([0.0, 500.0 * np.cos(towards) * METRE_DEG])
    east_deg = 500.0 * np.sin(towards) * METRE_DEG / np.cos(np.deg2rad(lat_deg.mean()))
    lon_deg = -158.0 + np.array([0.0, east_deg])
    times = instants("2010-04-01T22:00Z", 1200)
    ghi_wm2 = synthetic_ghi(times, lat_deg, lon_deg, 5.0, settings, 1)
    index = ghi_wm2 / clear_sky_ghi(times, lat_deg, lon_deg, 5.0, 3.0)[:, None]
    likeness = {
        lag: np.corrcoef(index[: 1200 - lag, 0], index[lag:, 1])[0, 1] for lag in range(0, 120, 5)
    }
    assert max(likeness, key=lambda lag: likeness[lag]) == 50
    assert likeness[50] > 0.99
    assert likeness[0] < 0.8


def test_clouds_change_their_shape_within_the_evolution_time() -> None:
    # Without drift only the evolution changes what a sensor sees.
    still = CloudSettings(drift_speed_ms=0.0, evolution_s=1200.0)
    index = clear_sky_index(instants("2010-04-01T22:00Z", 1201), still)
    spread = index.std()
    assert np.abs(index[10] - index[0]).max() < 0.1 * spread
    assert np.abs(index[1200] - index[0]).max() > spread


@pytest.mark.parametrize("cloud_cover", [0.2, 0.5, 0.8])
def test_the_share_of_covered_sky_is_the_one_asked_for(cloud_cover: float) -> None:
    # A cloud without scattered light: the index falls below half way inside the edge.
    settings = CloudSettings(cloud_cover=cloud_cover, edge_enhancement=1.0, drift_speed_ms=40.0)
    times = pd.date_range("2010-04-01T17:00Z", "2010-04-02T04:00Z", freq="10s")
    below_edge = clear_sky_index(times, settings, seed=2) < 0.25 + 0.75 * 2.0 ** (-0.08 / 0.5)
    assert below_edge.mean() == pytest.approx(cloud_cover, abs=0.07)


def test_no_cloud_is_a_clear_sky_and_full_cover_is_thick_cloud() -> None:
    times = instants("2010-04-01T22:00Z", 30)
    np.testing.assert_allclose(clear_sky_index(times, CloudSettings(cloud_cover=0.0)), 1.0)
    np.testing.assert_allclose(clear_sky_index(times, CloudSettings(cloud_cover=1.0)), 0.25)


def test_it_is_dark_at_night() -> None:
    times = instants("2010-04-01T10:00Z", 30)
    assert not synthetic_ghi(times, LAT_DEG, LON_DEG, 5.0, CloudSettings(), 1).any()


def test_the_clear_sky_index_has_two_peaks(noon_index: NDArray[np.float64]) -> None:
    share, _ = np.histogram(noon_index, bins=[0.25, 0.5, 0.75, 1.0, 1.15 + 1e-9])
    cloudy, dim, bright, clear = share / noon_index.size
    assert cloudy > 1.5 * dim
    assert clear > 1.5 * bright
    assert cloudy + dim + bright + clear == pytest.approx(1.0)


def test_changes_within_a_second_are_some_tens_of_watts(noon_index: NDArray[np.float64]) -> None:
    one_second = np.abs(change(noon_index, 1))
    ten_seconds = np.abs(change(noon_index, 10))
    assert 0.03 < np.quantile(one_second, 0.99) < 0.12
    assert one_second.max() < 0.3
    assert 0.3 < np.quantile(ten_seconds, 0.99) < 0.7


def test_sensors_far_apart_change_independently(noon_index: NDArray[np.float64]) -> None:
    distance_m = distances_m(LAT_DEG, LON_DEG)
    near, middle, far = correlation_by_distance(noon_index, distance_m, (0, 200, 400, 1500))
    assert near > 0.4
    assert near > middle > far
    assert abs(far) < 0.15


def test_the_field_behaves_like_the_hope_measurements() -> None:
    """Same places, same hour: changes and correlations within a factor of the measured ones."""
    default = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    folder = Path(os.environ.get("HELIARCH_DATA", default)) / "hope-melpitz-1s"
    if not folder.is_dir():
        pytest.skip(f"measured data is absent: {folder} (HELIARCH_DATA names its folder)")
    hope = read_measured_ghi(folder / "ghi_20130908_0915_0955.csv", folder / "positions.csv")
    place = (hope.lat_deg, hope.lon_deg, 86.0)
    clear_wm2 = clear_sky_ghi(hope.times, *place, 3.0)[:, None]
    measured = hope.ghi_wm2 / clear_wm2
    synthetic = synthetic_ghi(hope.times, *place, CloudSettings(), 1) / clear_wm2
    for lag in (1, 10, 30):
        of_measured = np.quantile(np.abs(change(measured, lag)), 0.99)
        of_synthetic = np.quantile(np.abs(change(synthetic, lag)), 0.99)
        assert 0.5 < of_synthetic / of_measured < 1.5
    limits_m = (0, 100, 200, 300, 800, 3000)
    distance_m = distances_m(hope.lat_deg, hope.lon_deg)
    np.testing.assert_allclose(
        correlation_by_distance(synthetic, distance_m, limits_m),
        correlation_by_distance(measured, distance_m, limits_m),
        atol=0.3,
    )


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("cloud_cover", 1.1),
        ("cloud_cover", float("nan")),
        ("drift_speed_ms", -1.0),
        ("drift_from_deg", 361.0),
        ("cloud_size_m", 0.0),
        ("thick_cloud_index", 0.0),
        ("edge_enhancement", 0.9),
        ("evolution_s", 0.0),
        ("linke_turbidity", 0.5),
    ],
)
def test_settings_out_of_range_are_refused(field: str, value: float) -> None:
    with pytest.raises(msgspec.ValidationError, match=rf"at `\$\.{field}`"):
        msgspec.convert({field: value}, CloudSettings)


def test_an_unknown_setting_is_refused() -> None:
    with pytest.raises(msgspec.ValidationError, match="unknown field `cover`"):
        msgspec.convert({"cover": 0.5}, CloudSettings)
