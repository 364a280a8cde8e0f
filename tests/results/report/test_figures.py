"""What figures show is found by its rule, in runs made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from plans_by_hand import with_changes
from synthetic_runs import cloudy_run

from results.report.inverter_figures import correlation_by_hour
from results.report.plant_figures import farthest_from_asked
from results.report.style import clock_ms


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
    plan = with_changes(run.plan, timezone="Europe/Berlin", start_time_ns=begin_ns)
    run = replace(run, plan=plan)
    assert run.times[0].utcoffset() != run.times[-1].utcoffset()
    assert np.diff(clock_ms(run)).tolist() == [3_600_000.0] * 3
