"""A comparison runs its schemes on each case."""

from __future__ import annotations

import pytest

from bus_schemas.errors import InputError
from scenarios.preparation import RunOptions
from scenarios.scenario import load_scenario
from studies.compare.cases import cases
from studies.compare.study import run_case


def test_grouping_has_its_best_median_and_worst_reference_group(plant: str) -> None:
    (case,) = cases(load_scenario(plant), RunOptions(duration="60"), seeds=(1,))
    paper, *groups = run_case(("paper", "grouping"), (), case)
    names = ["grouping best", "grouping median", "grouping worst"]
    assert [paper["scheme"], *(row["scheme"] for row in groups)] == ["paper", *names]
    missed = [row["control-caused-energy"] + row["over-delivered-energy"] for row in groups]
    assert missed == sorted(missed)


def test_every_scheme_but_the_bounds_is_run_with_each_actuator() -> None:
    (case,) = cases(load_scenario("oahu"), RunOptions(duration="120"), seeds=(1,))
    schemes = ("uncontrolled", "uniform-cap", "paper")
    rows = run_case(schemes, ("fraction", "limit"), case)
    found = {(row["scheme"], row["actuator"]): row for row in rows}
    assert [*found] == [
        ("uncontrolled", None),
        *((scheme, actuator) for scheme in schemes[1:] for actuator in ("fraction", "limit")),
    ]
    (own,) = run_case(("paper",), (), case)
    assert own == found["paper", "limit"], "oahu's own actuator"
    # A limit holds whatever the sky does, a fraction of an old maximum does not.
    beyond = "over-delivered-energy"
    assert found["uniform-cap", "limit"][beyond] == pytest.approx(0.0)
    assert found["uniform-cap", "fraction"][beyond] > 1e-3


def test_a_case_that_does_not_fit_is_named() -> None:
    (case,) = cases(load_scenario("oahu"), RunOptions(duration="10"), faults=["kill=c9,at=1s"])
    with pytest.raises(InputError) as caught:
        run_case(("paper",), (), case)
    assert str(caught.value).startswith("fault=kill=c9,at=1s: ")
