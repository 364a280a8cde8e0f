"""The numbers that figures are drawn from, worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from synthetic_runs import cloudy_run

from recordings.read.series import RunSeries
from studies.report.inverter_figures import energy_beside_share
from studies.report.plant_figures import farthest_from_asked, folded_distribution
from studies.report.style import clock_ms

HOUR_MS = 3_600_000.0


# The tracking error -------------------------------------------------------------------------------


def test_the_distribution_is_folded_at_zero() -> None:
    error_kw, share = folded_distribution(np.array([-3.0, -1.0, -1.0, 0.0, 2.0]))
    np.testing.assert_array_equal(error_kw, [-3.0, -1.0, np.nan, 2.0])
    np.testing.assert_allclose(share, [1 / 5, 3 / 5, np.nan, 1 / 5])


# Regulation ---------------------------------------------------------------------------------------


def missing(run: RunSeries, cycles: slice, power_kw: float) -> RunSeries:
    """Return the run with its first inverter short of some power for a while."""
    delivered_kw = run.power_kw.copy()
    delivered_kw[cycles, 0] -= power_kw
    return replace(run, power_kw=delivered_kw)


def exact(run: RunSeries) -> RunSeries:
    """Return the run as if each inverter gave its share of what was desired."""
    share_kw = np.repeat(run.desired_kw[:, None] / len(run.inverters), len(run.inverters), axis=1)
    return replace(run, power_kw=share_kw)


def test_the_close_look_is_at_the_ten_minutes_of_the_largest_error() -> None:
    run = missing(exact(cloudy_run(cycles=3600, regulation=True)), slice(2000, 2600), 20.0)
    assert farthest_from_asked([run]) == range(2000, 2600)


def test_an_error_while_nothing_is_asked_does_not_draw_the_close_look() -> None:
    run = exact(cloudy_run(cycles=3600, regulation=True))
    regulation_kw = run.regulation_kw.copy()
    regulation_kw[:1800] = 0.0
    quiet = exact(replace(run, regulation_kw=regulation_kw))
    worse_before = missing(quiet, slice(0, 1700), 90.0)
    assert farthest_from_asked([missing(worse_before, slice(2900, 3500), 5.0)]).start >= 2800


# Energy beside the share --------------------------------------------------------------------------


def test_energy_given_and_lacking_is_counted_from_the_share_by_rating() -> None:
    run = replace(
        cloudy_run(cycles=2, cycle_s=1800.0, inverters=("a", "b")),
        rating_kw=np.array([100.0, 300.0]),
        commitment_kw=np.array([200.0, 200.0]),
        power_kw=np.array([[80.0, 110.0], [20.0, 180.0]]),
    )
    # Shares of 50 and 150 kW for half an hour each.
    given_kwh, lacking_kwh = energy_beside_share(run)
    assert given_kwh.tolist() == [15.0, 15.0]
    assert lacking_kwh.tolist() == [15.0, 20.0]


# Look ---------------------------------------------------------------------------------------------


def test_the_clock_does_not_go_back_where_summer_time_ends() -> None:
    # Berlin, 2026-10-25: 03:00 CEST is 02:00 CET.
    run = replace(
        cloudy_run(cycles=4, cycle_s=3600.0),
        timezone="Europe/Berlin",
        start_time_ns=1_792_886_400_000_000_000,
    )
    assert run.times[0].utcoffset() != run.times[-1].utcoffset()
    assert np.diff(clock_ms(run)).tolist() == [HOUR_MS] * 3
