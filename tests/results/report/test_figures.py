"""What figures show is found by its rule, in runs made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_runs import cloudy_run

from recordings.read.series import RunSeries
from results.report.cloud_passage import correlation_by_hour, find_cloud_passage
from results.report.plant_figures import farthest_from_asked
from results.report.style import clock_ms

SHARE_KW = 50.0
CYCLES = 600
SHADE_BEGINS = 300


def plant(**impp_kw: NDArray[np.float64]) -> RunSeries:
    """A run of four inverters, two clusters, asked for 50 kW each; inverters not named are flat."""
    inverters = ("c1/a", "c1/b", "c2/c", "c2/d")
    columns = [impp_kw.get(path[-1], np.full(CYCLES, 80.0)) for path in inverters]
    power_kw = np.column_stack(columns)
    run = cloudy_run(cycles=CYCLES, inverters=inverters)
    return replace(run, mpp_kw=power_kw, impp_kw=power_kw, residual_kw=power_kw - SHARE_KW)


def shade(depth_kw: float, begins: int = SHADE_BEGINS, lasts: int = 90) -> NDArray[np.float64]:
    """80 kW, but for a cloud that comes within 20 cycles and goes as fast."""
    cycle = np.arange(CYCLES)
    covered = np.clip(np.minimum(cycle - begins, begins + lasts - cycle) / 20.0, 0.0, 1.0)
    return np.asarray(80.0 - depth_kw * covered)


def rising() -> NDArray[np.float64]:
    """Always above the share, and hardly correlated with anything that dips in the middle."""
    return np.asarray(70.0 + 10.0 * np.abs(np.arange(CYCLES) - 300.0) / 300.0)


def test_the_shaded_one_and_the_one_with_headroom_are_told_apart() -> None:
    found = find_cloud_passage(plant(a=shade(60.0), b=rising()))
    assert found is not None
    assert (found.shaded, found.helping) == (0, 1)
    assert found.bottom == SHADE_BEGINS + 20
    assert found.drop_kw == pytest.approx(60.0)


def test_of_two_drops_the_larger_is_taken_whichever_cluster_it_is_in() -> None:
    found = find_cloud_passage(plant(a=shade(40.0), b=rising(), c=rising(), d=shade(65.0)))
    assert found is not None
    assert (found.shaded, found.helping) == (3, 2)
    assert found.correlation == pytest.approx(
        float(np.corrcoef(rising(), shade(65.0))[0, 1]), abs=1e-12
    )


def test_a_pair_under_the_same_cloud_is_not_taken_however_deep_it_is() -> None:
    found = find_cloud_passage(plant(a=shade(70.0), b=shade(65.0), c=rising(), d=shade(40.0)))
    assert found is not None
    assert (found.shaded, found.helping) == (3, 2)


def test_a_drop_that_stays_above_the_share_is_no_need() -> None:
    assert find_cloud_passage(plant(a=shade(25.0), b=rising())) is None


def test_an_hour_in_which_nothing_varies_has_no_correlation_to_show() -> None:
    run = cloudy_run(cycles=7200)
    mpp_kw = run.mpp_kw.copy()
    mpp_kw[:3600] = 0.0
    assert list(correlation_by_hour(run)) == [10, 11]
    assert list(correlation_by_hour(replace(run, mpp_kw=mpp_kw))) == [11]


def test_the_close_look_is_at_the_ten_minutes_of_the_largest_error_in_what_was_asked() -> None:
    run = cloudy_run(cycles=3600, regulation=True)
    asked_kw = np.where(np.arange(3600) < 1800, 0.0, run.regulation_kw)
    run = replace(run, regulation_kw=asked_kw)
    power_kw = np.repeat(run.dispatch_kw[:, None] / len(run.inverters), len(run.inverters), axis=1)
    power_kw[:1700, 0] -= 90.0  # Nothing is asked there.
    power_kw[2000:2600, 0] -= 20.0
    assert farthest_from_asked([replace(run, power_kw=power_kw)]) == range(2000, 2600)


def test_the_clock_does_not_go_back_where_summer_time_ends() -> None:
    # Berlin, 2026-10-25: 03:00 CEST is 02:00 CET.
    run = cloudy_run(cycles=4, cycle_s=3600.0)
    begin_ns = 1_792_886_400_000_000_000
    plant = replace(run.plant, timezone="Europe/Berlin", start_time_ns=begin_ns)
    run = replace(run, plant=plant)
    assert run.times[0].utcoffset() != run.times[-1].utcoffset()
    assert np.diff(clock_ms(run)).tolist() == [3_600_000.0] * 3
