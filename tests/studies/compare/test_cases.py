"""From the words of the command line to the cases of a study."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import date

import pytest

from bus_schemas.errors import InputError
from scenarios.preparation import RunOptions
from scenarios.scenario import ScenarioFile, load_scenario
from scenarios.settings import parse_setting
from sim_plant.commitment import ShareOfClearSky
from studies.compare.cases import Case, cases, label, parse_days, parse_seeds


@pytest.fixture(scope="module")
def oahu() -> ScenarioFile:
    return load_scenario("oahu")


def study(
    oahu: ScenarioFile,
    *words: str,
    faults: Sequence[str] = (),
    days: str = "",
    seeds: str = "",
    start: str = "12:30",
) -> list[Case]:
    return cases(
        oahu,
        RunOptions(start=start, duration="60"),
        [parse_setting(word) for word in words],
        faults,
        parse_days(days) if days else (),
        parse_seeds(seeds) if seeds else (),
    )


def test_a_setting_is_a_field_and_its_values() -> None:
    found = parse_setting("control.period_cycles=[1, 1], [10, 1]")
    assert (found.field, found.values) == ("control.period_cycles", ([1, 1], [10, 1]))
    assert parse_setting("title=\"Clouds, it's windy\", 'calm'").values == (
        "Clouds, it's windy",
        "calm",
    )
    assert parse_setting("title=it's windy, calm").values == ("it's windy", "calm")
    assert parse_setting("control.clusters_seed=1..3").values == (1, 2, 3)


def test_every_combination_is_a_case_with_its_own_label(oahu: ScenarioFile) -> None:
    found = study(oahu, "commitment.share=0.3,0.4", "plant.actuator=fraction", seeds="1..2")
    assert [label(case.columns) for case in found] == [
        "share=0.3 actuator=fraction seed=1",
        "share=0.3 actuator=fraction seed=2",
        "share=0.4 actuator=fraction seed=1",
        "share=0.4 actuator=fraction seed=2",
    ]
    last = found[-1]
    assert last.scenario.scenario.commitment == ShareOfClearSky(0.4)
    assert last.scenario.scenario.plant.actuator == "fraction"
    assert last.options == RunOptions(start="12:30", duration="60", seed=2)
    assert oahu.scenario.plant.actuator == "limit", "the scenario itself stays as it was"
    (alone,) = study(oahu)
    assert (label(alone.columns), alone.scenario) == ("", oahu)


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        (("commitment.share=",), "--set: expected"),
        (("commitment.share=two",), "commitment.share: expected"),
        ((f"plant.actuator={'[' * 10_000}",), "plant.actuator: expected"),
        (("nothing.at.all=1",), "got 'nothing'"),
        (("title.text=1",), "title: expected"),
        (("control.hold_cycles=3", "plant.actuator=wheel"), "--set plant.actuator=wheel: "),
    ],
)
def test_a_setting_that_the_scenario_does_not_accept_is_named(
    oahu: ScenarioFile, words: tuple[str, ...], wrong: str
) -> None:
    with pytest.raises(InputError) as caught:
        study(oahu, *words)
    assert wrong in str(caught.value)


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        *((parse_seeds, text) for text in ("1..", "a", "3..1", "1..1000000")),
        *((parse_days, text) for text in ("2010-02-30", "2010-04-02..2010-04-01")),
    ],
)
def test_wrong_lists_are_refused(parse: Callable[[str], object], text: str) -> None:
    with pytest.raises(InputError, match="--seeds" if parse is parse_seeds else "--days"):
        parse(text)


def test_a_study_without_end_is_refused(oahu: ScenarioFile) -> None:
    with pytest.raises(InputError, match="100,000"):
        study(oahu, days="1990-01-01..2020-01-01", seeds="1..1000")


def test_seeds_and_days_are_lists_and_ranges() -> None:
    assert parse_seeds("1..3,9") == (1, 2, 3, 9)
    days = (date(2010, 4, 30), date(2010, 5, 1), date(2010, 6, 1))
    assert parse_days("2010-04-30..2010-05-01,2010-06-01") == days
