"""Highlights of a run: its hardest minutes, and its power in few steps."""

from __future__ import annotations

from io import StringIO

import msgspec
import numpy as np
import pytest
from plans_by_hand import plan_of
from rich.console import Console

from recordings.read.series import RunSeries
from results.figures import FIGURES, Figures
from results.headline import curve_lines, headline
from results.highlights import Highlights, highlights

PLAN = plan_of({"c1/a": 100.0, "c1/b": 100.0, "c2/c": 200.0}, cycles=180, actuator="limit")
"""Three minutes. The plant promises 200 kW: shares of 50, 50 and 100 kW."""


def shaded_run() -> RunSeries:
    """In the second minute `a` is shaded, and `c` covers for it but for 5 kW in one cycle."""
    mpp_kw = np.tile([100.0, 100.0, 200.0], (180, 1))
    power_kw = np.tile([50.0, 50.0, 100.0], (180, 1))
    mpp_kw[60:70, 0] = power_kw[60:70, 0] = 20.0
    power_kw[60:70, 2] = 130.0
    mpp_kw[65, 0] = power_kw[65, 0] = 10.0
    power_kw[65, 2] = 135.0
    values = {"commitment_kw": np.full(180, 200.0), "mpp_kw": mpp_kw, "power_kw": power_kw}
    return RunSeries.of(PLAN, "by hand", values | {"regulation_kw": np.zeros(180)})


def test_a_hard_minute_names_who_lacked_power_and_who_gave_it() -> None:
    (minute,) = highlights(shaded_run()).hard_minutes
    assert minute.cycle == 65
    assert dict(minute.lacking) == pytest.approx({"c1/a": 40.0})
    assert dict(minute.gave) == pytest.approx({"c2/c": 35.0})
    assert minute.missed_kw == pytest.approx(5.0)
    assert minute.missed_kwh == pytest.approx(5.0 / 3600.0)
    assert minute.without_help_kwh == pytest.approx((9 * 30.0 + 40.0) / 3600.0)


def test_unknown_cycles_are_gaps_of_the_curve_and_no_hard_minutes() -> None:
    run = shaded_run()
    run.power_kw[60:66] = np.nan
    found = highlights(run)
    document = msgspec.json.encode(found)
    assert msgspec.json.decode(document, type=Highlights).curve.delivered_kw[20] is None
    assert found.hard_minutes[0].cycle not in range(60, 66)


@pytest.mark.parametrize("can_draw", [True, False])
def test_the_curves_fit_a_narrow_terminal(can_draw: bool) -> None:
    lines = list(curve_lines(highlights(shaded_run()).curve, can_draw, 80))
    assert [line.split()[0] for line in lines] == ["available", "dispatch", "delivered"]
    assert max(map(len, lines)) <= 80
    Console(file=StringIO(), width=80).print(*lines)
    assert can_draw or all(line.isascii() for line in lines)


def test_the_headline_has_the_baseline_only_where_it_is_known() -> None:
    figures: Figures = dict.fromkeys(FIGURES)
    figures |= {"control-caused": 0.009, "without-help": 2.3, "unavoidable": 0.0}
    assert "2.30 %" in headline(figures)
    assert "0.50 % by the plant's meter" in headline(figures | {"metered-control-caused": 0.5})
    assert "without" not in headline(figures | {"without-help": None})
