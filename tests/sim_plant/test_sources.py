"""Where possible power comes from, measured at another step or on another day than the run."""

from dataclasses import replace
from datetime import timedelta

import numpy as np
import pandas as pd
from complaints import complaint_of

from sim_plant import Floats
from sim_plant.irradiance import Irradiance
from sim_plant.pv import PvSettings
from sim_plant.sites import Sites
from sim_plant.sources import MeasuredPlant, PlantUnderSky, measured_sky

SITES = Sites(
    ("a", "b"), np.array([21.31, 21.32]), np.array([-158.08, -158.07]), np.array([100.0, 300.0])
)
NOON = pd.Timestamp("2010-04-01T22:00:00Z")


def irradiance(
    begin: pd.Timestamp = NOON, base_wm2: float = 300.0, report: tuple[str, ...] = ()
) -> Irradiance:
    times = pd.date_range(begin, periods=60, freq="1s")
    ghi_wm2 = base_wm2 + np.column_stack([np.arange(60.0), 3.0 * np.arange(60.0)])
    return Irradiance(times, ghi_wm2, SITES.names, SITES.lat_deg, SITES.lon_deg, "ghi.csv", report)


def sky(
    given: Irradiance | None = None,
    earlier: MeasuredPlant | None = None,
    earlier_by: timedelta = timedelta(0),
) -> MeasuredPlant:
    under = PlantUnderSky(SITES, 11.0, PvSettings())
    found = measured_sky(under, irradiance() if given is None else given)
    return replace(found, earlier=earlier, earlier_by=earlier_by)


def plant() -> MeasuredPlant:
    times = pd.date_range(NOON, periods=6, freq="10s")
    power_kw: Floats = np.arange(12.0).reshape(6, 2)
    return MeasuredPlant(SITES, times, power_kw, "hour.csv", ("hour.csv: a remark",))


def cycles(count: int, freq: str, begin: pd.Timestamp = NOON) -> pd.DatetimeIndex:
    return pd.date_range(begin, periods=count, freq=freq)


def test_an_earlier_day_is_at_the_same_time_of_day() -> None:
    before = sky(irradiance(NOON - pd.Timedelta(3, unit="D"), base_wm2=100.0))
    given = sky(earlier=before, earlier_by=timedelta(days=3))
    times = cycles(4, "1s", NOON + pd.Timedelta(20, unit="s"))
    np.testing.assert_array_equal(
        given.earlier_day_kw(times), before.possible_kw(times - pd.Timedelta(3, unit="D"))
    )
    assert (given.earlier_day_kw(times) < given.possible_kw(times)).all()


def test_measurements_of_one_day_have_no_earlier_one() -> None:
    found = complaint_of(plant().earlier_day_kw, cycles(2, "10s"))
    assert found.startswith("neighbours.history: expected")


def test_repairs_of_both_days_are_told() -> None:
    before = sky(irradiance(report=("yesterday",)))
    both = sky(irradiance(report=("today",)), earlier=before, earlier_by=timedelta(days=1))
    assert both.remarks == ("today", "yesterday")
    assert plant().remarks == ("hour.csv: a remark",)
