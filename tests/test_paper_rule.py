"""The paper's rule gives what an independent calculation gave.

Over arrays, which are equal to the agents bit for bit (`tests/studies/arrays`).
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from agents.plan import RunPlan
from results.figures import energy_figures
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario
from sim_plant.profile import Profile
from studies.arrays.schemes import run_scheme


def hope_hour(folder: Path, share: float) -> tuple[RunPlan, Profile]:
    """The HOPE hour with P = GHI / 1000 x 470 kW x 0.96 in place of the PV model."""
    options = RunOptions(scheme="paper", actuator="fraction")
    plan = prepare(load_scenario("hope-melpitz", folder), options, "hope").plan
    stations = [leaf.rpartition("/inv")[2] for leaf in plan.tree.leaves]
    with (folder / "ghi_20130908_0915_0955.csv").open(newline="") as file:
        ghi_wm2 = np.array([[float(row[s]) for s in stations] for row in csv.DictReader(file)])
    mpp_kw = np.minimum(ghi_wm2 / 1000.0 * 470.0 * 0.96, 8000.0 / 17.0)
    commitment_kw = np.full(len(mpp_kw), share * np.median(mpp_kw.sum(axis=1)))
    return plan, Profile(mpp_kw, commitment_kw)


@pytest.mark.parametrize(
    ("share", "unavoidable_percent", "control_caused_percent"),
    [(0.5, 0.0, 0.228), (0.7, 0.916, 0.222), (0.8, 2.736, 0.213), (0.9, 5.063, 0.192)],
)
def test_the_hope_hour_gives_what_an_independent_calculation_gave(
    data_folder: Path, share: float, unavoidable_percent: float, control_caused_percent: float
) -> None:
    plan, profile = hope_hour(data_folder / "hope-melpitz-1s", share)
    (run,) = run_scheme("paper", plan, profile, plan.control.actuator)
    figures = energy_figures(run.dispatch_kw, run.available_kw, run.delivered_kw, 1.0)
    found = figures["unavoidable"], figures["control-caused"]
    assert found == pytest.approx((unavoidable_percent, control_caused_percent), abs=6e-4)
