"""The predictive scheme misses and over-delivers at most as much as the paper's rule.

Both actuators, with and without meter noise, at commitments from half to nine tenths of the median.
Behind a limit the maximum is really hidden: the direct controllers hear of nothing but their own
meters.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from scenarios.preparation import RunOptions
from scenarios.scenario import ScenarioFile, load_scenario
from scenarios.settings import parse_setting
from studies.compare.cases import cases
from studies.compare.study import run_case

SETTINGS = ("plant.meter_noise=0,0.005", "plant.actuator=fraction,limit")
SHARES = "commitment.share=0.5,0.7,0.8,0.9"
ERRORS = ["control-caused", "over-delivered"]

MORE_MISSED = {"fraction": 0.0005, "limit": 0.02}
"""What may be missed, or delivered beyond, more than by the paper's rule, in %: a limit hides the
maximum."""


def study(
    scenario: ScenarioFile, *settings: str, skies: Sequence[dict[str, Any]] = ({},)
) -> pd.DataFrame:
    """Return a row for each case, and for each scheme in it, the paper's first."""
    words = [parse_setting(text) for text in (*settings, *SETTINGS)]
    rows = [
        row | {"case": f"{sky} {number}", "to": row["plant.actuator"]}
        for sky in skies
        for number, case in enumerate(cases(scenario, RunOptions(**sky), words))
        for row in run_case(("paper", "predictive"), (), case)
    ]
    return pd.DataFrame(rows).set_index(["scheme", "to", "case"])


def assert_less_in_the_mean(found: pd.DataFrame) -> None:
    sums: Any = found[ERRORS].sum(axis=1).groupby(level=["scheme", "to"]).mean()
    assert (sums["predictive"] <= sums["paper"]).all(), sums


@pytest.mark.parametrize(
    ("name", "folder", "settings"),
    [
        ("hope-melpitz", "hope-melpitz-1s", []),
        *(
            ("plant20mw", "plant20mw-combiners-10s", [f"irradiance.currents=hour_{hour}.csv"])
            for hour in "abc"
        ),
    ],
)
def test_on_measured_hours(data_folder: Path, name: str, folder: str, settings: list[str]) -> None:
    found = study(load_scenario(name, data_folder / folder), *settings, SHARES)
    assert len(found) == 2 * 16
    assert_less_in_the_mean(found)
    predictive: Any = found.loc["predictive"]
    more = predictive[ERRORS] - found.loc["paper"][ERRORS]
    for actuator, most in MORE_MISSED.items():
        assert (more.loc[actuator] <= most).all(axis=None), more


def test_under_synthetic_clouds_in_the_mean_of_ten_skies() -> None:
    """Under a calm sky the noise of meters may outweigh the clouds, as under that of seed 1."""
    shares = 'commitment={kind="share-of-median",share=0.5},{kind="share-of-median",share=0.8}'
    skies = [{"duration": "20m", "seed": seed} for seed in range(1, 11)]
    assert_less_in_the_mean(study(load_scenario("oahu"), shares, skies=skies))


def test_an_offset_buys_a_smaller_shortfall() -> None:
    offsets = "control.offset_errors=0,1,2"
    found: Any = study(load_scenario("oahu"), offsets, skies=[{"duration": "20m"}])
    for _, rows in found.loc["predictive"].groupby(["plant.meter_noise", "to"]):
        ascending = rows.sort_values("control.offset_errors")
        assert len(ascending) == 3
        assert ascending["control-caused"].is_monotonic_decreasing
        assert ascending["over-delivered"].is_monotonic_increasing
