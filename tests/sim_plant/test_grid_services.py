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


def test_a_step_of_the_dispatch_becomes_a_ramp_up_and_down_at_its_own_limit() -> None:
    dispatch_kw = np.where(np.arange(CYCLES) % 100 < 50, 200.0, 240.0)
    series, _ = run_of(dispatch_kw=dispatch_kw, ramp_up_kw_per_min=60.0, ramp_down_kw_per_min=120.0)
    # From cycle 50 on it rises by 1 kW a cycle, from cycle 100 on it falls by 2 kW.
    assert series.delivered_kw[[49, 50, 59, 89, 90]] == pytest.approx([200, 201, 210, 240, 240])
    assert series.delivered_kw[[100, 109, 119, 120]] == pytest.approx([238, 220, 200, 200])
    assert series.desired_kw == pytest.approx(series.delivered_kw)
    assert run_figures(series)["ramp-control"] == 0.0


def test_droop_moves_the_plant_and_the_correction_does_not_take_it_back() -> None:
    # 0.3 Hz of 60 less the deadband, times 20, times 400 kW are 35.2 kW.
    series, _ = run_of(hz=stepped(60.0, 60.3), droop=Droop())
    assert series.delivered_kw[99] == pytest.approx(200.0)
    assert series.delivered_kw[100:] == pytest.approx(164.8, abs=1e-6)
    (found,) = answers(series)
    assert (found.asked, found.cycle, found.to_90_s) == ("frequency", 100, 1.0)
    assert found.response_percent == pytest.approx(100.0)


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


def test_the_meter_reads_net_of_losses_with_its_error_and_the_correction_makes_up_for_losses() -> (
    None
):
    series, read = run_of(loss_constant_percent=0.5, loss_quadratic_percent=4.0)
    # P - 2 kW - 0.04 P^2 / 400 = 200 kW.
    gross_kw = (1.0 - (1.0 - 4.0 * 1e-4 * 202.0) ** 0.5) / 2e-4
    assert series.power_kw[100:].sum(axis=1) == pytest.approx(gross_kw, abs=1e-3)
    assert series.delivered_kw[100:] == pytest.approx(200.0, abs=1e-3)
    assert series.available_kw == pytest.approx(360.0 - 2.0 - 1e-4 * 360.0**2)
    assert read[-1].power_kw == pytest.approx(series.delivered_kw[-2])
    wrong, read = run_of(meter_error_percent=2.0)
    assert read[-1].power_kw == pytest.approx(200.0, abs=1e-3)
    assert wrong.delivered_kw[-1] == pytest.approx(200.0 / 1.02, abs=1e-3)


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
