"""The agents together do what an independent calculation of the paper's rule gives."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from agents.plan import RunPlan
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from sim_plant.profile import Profile
from studies.delays.study import run_in_memory
from studies.metrics import commitment_metrics


def hope_hour(folder: Path, share: float) -> tuple[RunPlan, Profile]:
    """The HOPE hour with P = GHI / 1000 x 470 kW x 0.96 in place of the PV model."""
    plan = prepare(load_scenario("hope-melpitz", folder), RunOptions(scheme="paper"), "hope").plan
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
    _, run = run_in_memory(*hope_hour(data_folder / "hope-melpitz-1s", share))
    energy = commitment_metrics(run.desired_kw, run.possible_kw, run.delivered_kw, 1.0)
    assert energy.percent(energy.unavoidable_kwh) == pytest.approx(unavoidable_percent, abs=6e-4)
    assert energy.percent(energy.control_caused_kwh) == pytest.approx(
        control_caused_percent, abs=6e-4
    )
