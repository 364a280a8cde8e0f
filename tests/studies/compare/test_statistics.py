"""Means with intervals, quantiles and paired differences of a few cases, by hand."""

from __future__ import annotations

from typing import get_args

import pytest
from results_by_hand import case, result

from agents.plan import Actuator
from studies.compare.statistics import Summary, summaries
from studies.compare.study import CaseResult
from studies.metrics.figures_of_merit import FIGURES_OF_MERIT

CAUSED = [FIGURES_OF_MERIT["control-caused"]]
ERROR = 4.302653 / 3.0**0.5
"""Of three values with a standard deviation of 1: Student's t for 2 degrees of freedom."""


def by_scheme(*cases: CaseResult) -> dict[str, Summary]:
    return {one.scheme: one for one in summaries(cases, CAUSED)}


def test_three_cases_by_hand() -> None:
    found = by_scheme(
        case("seed=1", {"paper": 1.0, "predictive": 0.0}),
        case("seed=2", {"paper": 2.0, "predictive": 0.0}),
        case("seed=3", {"paper": 3.0, "predictive": 3.0}),
    )
    paper = found["paper"]
    assert (paper.figure, paper.cases, paper.actuator) == ("control-caused", 3, "fraction")
    assert (paper.mean, paper.mean_error) == pytest.approx((2.0, ERROR))
    assert (paper.low, paper.median, paper.high) == pytest.approx((1.1, 2.0, 2.9))
    # Case by case paper causes 1, 2 and 0 more.
    assert paper.baseline == "predictive"
    assert (paper.difference, paper.difference_error) == pytest.approx((1.0, ERROR))
    assert found["predictive"].difference is None


def test_without_predictive_the_first_scheme_is_the_baseline() -> None:
    found = by_scheme(
        case("seed=1", {"paper": 1.0, "uniform-cap": 4.0}),
        case("seed=2", {"paper": 1.0, "uniform-cap": 4.0}),
    )
    assert found["uniform-cap"].baseline == "paper"
    assert (found["uniform-cap"].difference, found["uniform-cap"].difference_error) == (3.0, 0.0)


def test_schemes_are_paired_with_the_baseline_of_their_own_actuator() -> None:
    schemes = (
        result("paper", "fraction", 5.0),
        result("paper", "limit", 7.0),
        result("predictive", "fraction", 1.0),
        result("predictive", "limit", 2.0),
        result("uncontrolled", None, 0.0),
    )
    cases = [CaseResult(f"seed={seed}", "", schemes, 0.0, 0.0, ()) for seed in (1, 2)]
    found = [(one.scheme, one.actuator, one.difference) for one in summaries(cases, CAUSED)]
    assert found == [
        ("paper", "fraction", 4.0),
        ("paper", "limit", 5.0),
        ("predictive", "fraction", None),
        ("predictive", "limit", None),
        ("uncontrolled", None, -1.0),
    ]


def test_each_choice_of_settings_is_a_sample_of_its_own() -> None:
    cases = [
        case(f"share={share} seed={seed}", {"paper": share * seed}, f"share={share}")
        for share in (1.0, 10.0)
        for seed in (1, 2)
    ]
    found = [(one.settings, one.cases, one.mean) for one in summaries(cases, CAUSED)]
    assert found == [("share=1.0", 2, 1.5), ("share=10.0", 2, 15.0)]


def test_cases_that_differ_in_settings_alone_are_taken_together() -> None:
    cases = [case(f"share={share}", {"paper": share}, f"share={share}") for share in (1.0, 2.0)]
    (found,) = summaries(cases, CAUSED)
    assert (found.settings, found.cases, found.mean) == ("", 2, 1.5)


def test_a_figure_that_no_case_defines_has_no_summary() -> None:
    assert not list(summaries([case("seed=1", {"paper": 1.0})], [FIGURES_OF_MERIT["score"]]))


def test_one_case_has_a_mean_without_an_interval() -> None:
    found = by_scheme(case("seed=1", {"paper": 1.0, "predictive": 0.0}))["paper"]
    assert (found.mean, found.mean_error) == (1.0, None)
    assert (found.difference, found.difference_error) == (1.0, None)


def test_cases_with_different_actuators_have_none_in_common() -> None:
    cases = [
        CaseResult(f"actuator={name}", f"actuator={name}", (result("paper", name, 1.0),), 0, 0, ())
        for name in get_args(Actuator)
    ]
    (found,) = summaries(cases, CAUSED)
    assert (found.actuator, found.cases) == (None, 2)
