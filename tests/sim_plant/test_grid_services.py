"""What a grid asks, in the closed loop of all agents: ramps, droop, reserve, losses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from memory_runs import run_in_memory
from numpy.typing import NDArray
from plans_by_hand import FOUR, plan_of

from agents.plan import RunPlan
from agents.settings import Droop, GridSettings
from bus_schemas.messages import Meter
from bus_schemas.signals import METER
from bus_schemas.tree import ROOT
from recordings.read.series import RunSeries, SeriesCollector
from results.answers import answers
from results.figures import run_figures
from sim_plant.profile import Profile

CYCLES = 200
LAW = {"scheme": "predictive", "actuator": "limit", "correction": True}


def run_of(
    *,
    dispatch_kw: float | NDArray[np.float64] = 200.0,
    available_kw: float | NDArray[np.float64] = 90.0,
    hz: float | NDArray[np.float64] = 60.0,
    available_bias: float | None = None,
    **grid: Any,
) -> tuple[RunSeries, list[Meter]]:
    """Run four inverters of 100 kW; `available_kw` is what each of them could give."""
    asked = GridSettings(**grid)
    plan: RunPlan = plan_of(FOUR, cycles=CYCLES, grid=asked, available_bias=available_bias, **LAW)
    available = np.broadcast_to(available_kw, CYCLES)
    profile = Profile(
        np.repeat(available[:, None], 4, axis=1).astype(float),
        np.broadcast_to(dispatch_kw, CYCLES).astype(float),
        frequency_hz=np.broadcast_to(hz, CYCLES).astype(float),
    )
    _, sent = run_in_memory(plan, profile)
    collector = SeriesCollector(plan)
    for port, message in sent.messages:
        collector.see(port, message)
    return collector.series("by hand"), list(sent.of(METER.of(ROOT)).values())


def stepped(before: float, after: float, at: int = 100) -> NDArray[np.float64]:
    return np.where(np.arange(CYCLES) < at, before, after)


def test_upwards_it_responds_out_of_the_reserve_that_it_has_kept() -> None:
    # All that there is is asked for, 340 kW; of these 20 are kept, and then they are given.
    low_hz, all_kw = stepped(60.0, 59.7), {"dispatch_kw": 340.0, "available_kw": 85.0}
    droop = Droop(reserve_percent=5.0)
    series, _ = run_of(**all_kw, hz=low_hz, available_bias=0.0, droop=droop)
    assert series.delivered_kw[50:100] == pytest.approx(320.0, abs=0.1)
    assert series.delivered_kw[101:] == pytest.approx(340.0, abs=0.1)
    assert series.desired_kw[99:101] == pytest.approx([340.0, 360.0])
    (found,) = answers(series)
    assert found.response_percent is None, "beyond what the sky gives nothing is judged"
    faded, _ = run_of(**all_kw, hz=low_hz, droop=droop)
    assert faded.delivered_kw[2] < 330.0
    assert faded.delivered_kw[6:] == pytest.approx(340.0, abs=0.1), "a hidden maximum hides it"
    without, _ = run_of(**all_kw, hz=low_hz, available_bias=0.0, droop=Droop())
    assert without.delivered_kw[50:] == pytest.approx(340.0, abs=0.1)
    assert not answers(without)


def test_a_correction_for_losses_in_saturation_is_gone_after_a_cycle() -> None:
    # For 100 cycles the sky gives 195 kW at the inverters, 191 kW at the meter, and 193 are asked
    # for. That may be meters that read low: the inverters are freed, for one cycle too many.
    sky_kw = stepped(195.0 / 4.0, 90.0)
    series, _ = run_of(dispatch_kw=193.0, available_kw=sky_kw, loss_constant_percent=1.0)
    assert series.delivered_kw[90:100] == pytest.approx(191.0)
    assert series.delivered_kw[100] == pytest.approx(4 * 90.0 - 4.0)
    assert series.delivered_kw[101:].max() < 193.0 + 1.0
    assert series.delivered_kw[110:] == pytest.approx(193.0, abs=1.0)


def test_ramps_that_clouds_force_on_the_plant_are_counted_apart_from_its_own() -> None:
    limits = {"ramp_up_kw_per_min": 60.0, "ramp_down_kw_per_min": 60.0}
    clouds, _ = run_of(available_kw=stepped(90.0, 20.0), **limits)
    found = run_figures(clouds)
    assert found["ramp-control"] == 0.0
    assert (found["ramp-clouds"] or 0.0) > 0.0
    steady, _ = run_of(hz=stepped(60.0, 60.5), droop=Droop(), **limits)
    found = run_figures(steady)
    assert (found["ramp-control"], found["ramp-clouds"]) == (0.0, 0.0), "response is no ramp"
