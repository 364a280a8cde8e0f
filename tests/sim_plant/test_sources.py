"""What a measured plant says of its data."""

from dataclasses import replace
from datetime import timedelta

import numpy as np
import pandas as pd

from sim_plant.sites import Sites
from sim_plant.sources import MeasuredPlant


def test_repairs_of_a_day_and_of_the_earlier_day_are_told() -> None:
    sites = Sites(("a",), np.array([21.31]), np.array([-158.08]), np.array([100.0]))
    times = pd.date_range("2010-04-01T22:00:00Z", periods=2, freq="10s")
    plant = MeasuredPlant(sites, times, np.ones((2, 1)), "hour.csv", ("today",))
    assert plant.remarks == ("today",)
    earlier = replace(plant, repairs=("yesterday",))
    both = replace(plant, earlier=earlier, earlier_by=timedelta(days=1))
    assert both.remarks == ("today", "yesterday")
