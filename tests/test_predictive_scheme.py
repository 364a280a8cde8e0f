"""The predictive scheme misses and over-delivers at most as much as the paper's rule.

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

SCHEMES = ("paper", "predictive")
SETTINGS = ("plant.meter_noise=0,0.005", "plant.actuator=fraction,limit")
SHARES = "commitment.share=0.5,0.7,0.8,0.9"


def study(
    scenario: ScenarioFile, *settings: str, options: RunOptions | None = None
) -> Sequence[list[Row]]:
    words = [parse_setting(text) for text in (*settings, *SETTINGS)]
    found = cases(scenario, options or RunOptions(), words)
    return [run_case(SCHEMES, (), case) for case in found]


MORE_MISSED_BEHIND_LIMITS = 0.02
"""What may be missed beyond the paper's rule where a limit hides the maximum, in %."""


def assert_no_more_than_the_papers(results: Sequence[list[Row]]) -> None:
    """On both sides: what it delivers too much is bounded too."""
    for rows in results:
        paper, predictive = rows[-2:]
        hides = predictive["plant.actuator"] == "limit"
        more = MORE_MISSED_BEHIND_LIMITS if hides else 0.0005
        assert predictive["control-caused"] <= paper["control-caused"] + more, rows
        assert predictive["over-delivered"] <= paper["over-delivered"] + more, rows


def both_sums(results: Sequence[list[Row]], actuator: str) -> list[tuple[float, float]]:
    """The sum of both errors of the paper's rule and of the scheme, in each case."""
    return [
        (_sum(rows[-2]), _sum(rows[-1]))
        for rows in results
        if rows[-1]["plant.actuator"] == actuator
    ]


def _sum(row: Row) -> float:
    return float(row["control-caused"]) + float(row["over-delivered"])


def assert_less_in_the_mean(results: Sequence[list[Row]]) -> None:
    for actuator in ("fraction", "limit"):
        paper, predictive = zip(*both_sums(results, actuator), strict=True)
        assert sum(predictive) <= sum(paper), (actuator, results)


def test_on_the_hope_hour(data_folder: Path) -> None:
    results = study(load_scenario("hope-melpitz", data_folder / "hope-melpitz-1s"), SHARES)
    assert len(results) == 16
    assert_no_more_than_the_papers(results)
    assert_less_in_the_mean(results)


@pytest.mark.parametrize("hour", ["a", "b", "c"])
def test_on_the_hours_of_a_real_plant(data_folder: Path, hour: str) -> None:
    scenario = load_scenario("plant20mw", data_folder / "plant20mw-combiners-10s")
    results = study(scenario, f"irradiance.currents=hour_{hour}.csv", SHARES)
    assert len(results) == 16
    assert_no_more_than_the_papers(results)
    assert_less_in_the_mean(results)


def test_under_synthetic_clouds_in_the_mean_of_ten_skies() -> None:
    """Under a calm sky the noise of meters may outweigh the clouds, as under that of seed 1."""
    shares = 'commitment={kind="share-of-median",share=0.5},{kind="share-of-median",share=0.8}'
    scenario = load_scenario("oahu")
    skies = [RunOptions(duration="20m", seed=seed) for seed in range(1, 11)]
    assert_less_in_the_mean(
        [rows for one in skies for rows in study(scenario, shares, options=one)]
    )


def test_an_offset_buys_a_smaller_shortfall() -> None:
    options = RunOptions(duration="20m")
    results = study(load_scenario("oahu"), "control.offset_errors=0,1,2", options=options)
    by_actuator: dict[tuple[object, object], list[tuple[float, float]]] = {}
    for rows in results:
        last = rows[-1]
        key = last["plant.meter_noise"], last["plant.actuator"]
        errors = last["control-caused"], last["over-delivered"]
        by_actuator.setdefault(key, []).append(errors)
    for cases_of_one in by_actuator.values():
        missed, over = zip(*cases_of_one, strict=True)
        assert list(missed) == sorted(missed, reverse=True)
        assert list(over) == sorted(over)
