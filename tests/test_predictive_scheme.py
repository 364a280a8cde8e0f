"""The predictive scheme causes no more shortfall than the paper's rule or the best grouping.

What it delivers too much for that is bounded too: else a scheme that curtails nothing would win.

Both actuators, with and without meter noise, at commitments from half to nine tenths of the median.
Behind a limit the maximum is really hidden: the direct controllers hear of nothing but their own
meters.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from scenarios.preparation import RunOptions
from scenarios.scenario import ScenarioFile, load_scenario
from scenarios.settings import parse_setting
from studies.compare.cases import cases
from studies.compare.study import Row, run_case

SCHEMES = ("grouping", "paper", "predictive")
SETTINGS = ("plant.meter_noise=0,0.005", "plant.actuator=fraction,limit")
SHARES = "commitment.share=0.5,0.7,0.8,0.9"


def study(
    scenario: ScenarioFile, *settings: str, options: RunOptions | None = None
) -> Sequence[list[Row]]:
    words = [parse_setting(text) for text in (*settings, *SETTINGS)]
    found = cases(scenario, options or RunOptions(), words)
    return [run_case(SCHEMES, (), case) for case in found]


DEAREST = 3.4
"""Over-delivery that the scheme may cost, in those of the paper's rule."""


def assert_predictive_wins(results: Sequence[list[Row]]) -> None:
    """In shortfall, at a bounded over-delivery."""
    for rows in results:
        beyond = {row["scheme"]: row["over-delivered"] for row in rows}
        # Half a per cent is what noise costs, whatever the sky.
        allowed = max(DEAREST * beyond["paper"], 0.6)
        assert beyond["predictive"] <= allowed, rows
        caused = {row["scheme"]: row["control-caused-energy"] for row in rows}
        # A watt-hour: what two schemes without any shortfall may differ by.
        rivals = min(caused["paper"], caused["grouping best"]) + 1e-3
        assert caused["predictive"] <= rivals, rows


def assert_shortfall_below_a_twentieth_of_a_percent(results: Sequence[list[Row]]) -> None:
    for rows in results:
        assert rows[-1]["control-caused"] <= 0.05, rows[-1]


def test_on_the_hope_hour(data_folder: Path) -> None:
    scenario = load_scenario("hope-melpitz", data_folder / "hope-melpitz-1s")
    results = study(scenario, SHARES)
    assert len(results) == 16
    assert_predictive_wins(results)
    assert_shortfall_below_a_twentieth_of_a_percent(results)
    exact = [
        result
        for result in results
        if result[0]["plant.meter_noise"] == 0 and result[0]["plant.actuator"] == "fraction"
    ]
    assert len(exact) == 4
    for *_, paper, predictive in exact:
        assert predictive["over-delivered"] <= paper["over-delivered"], predictive


@pytest.mark.parametrize("hour", ["a", "b", "c"])
def test_on_the_hours_of_a_real_plant(data_folder: Path, hour: str) -> None:
    scenario = load_scenario("plant20mw", data_folder / "plant20mw-combiners-10s")
    results = study(scenario, f"irradiance.currents=hour_{hour}.csv", SHARES)
    assert_predictive_wins(results)
    # Where a limit hides the maximum, more is missed: up to 0.1 % in hour a.
    by_fraction = [result for result in results if result[0]["plant.actuator"] == "fraction"]
    assert len(by_fraction) == 8
    assert_shortfall_below_a_twentieth_of_a_percent(by_fraction)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_under_synthetic_clouds(seed: int) -> None:
    options = RunOptions(duration="20m", seed=seed)
    shares = 'commitment={kind="share-of-median",share=0.5},{kind="share-of-median",share=0.8}'
    assert_predictive_wins(study(load_scenario("oahu"), shares, options=options))
