"""The rules of `--fault` and of a scenario: read, checked against the run, refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from complaints import complaint_of
from own_scenarios import Folder

from bus_schemas.errors import InputError
from bus_schemas.faults import FaultRule
from bus_schemas.tree import ControlTree
from launch_scripts.scenarios.fault_rules import fault_rules, parse_fault
from launch_scripts.scenarios.preparation import Preparation
from launch_scripts.scenarios.scenario import load_scenario


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("delay=0.05s, listener=central", FaultRule(listener="central", delay_ms=50.0)),
        ("loss=0.5%", FaultRule(loss=0.005)),
        ("loss=0.125,duplicate=1", FaultRule(loss=0.125, duplicate=1.0)),
        ("reorder=10%,reorder-by=1500ms", FaultRule(reorder=0.1, reorder_ms=1500.0)),
        ("silent=0s..1m,silent=2m..0.05h", FaultRule(silent=((0.0, 60.0), (120.0, 180.0)))),
        ("delay=1s,distribution=normal", FaultRule(delay_ms=1000.0, distribution="normal")),
        ("kill=c2,at=30s", FaultRule(kill="c2", at=(30.0,))),
        ("partition=c1|central,at=30s..60s", FaultRule(partition="c1|central", at=(30.0, 60.0))),
    ],
)
def test_the_words_of_an_option_become_a_rule_and_name_it(text: str, rule: FaultRule) -> None:
    assert parse_fault(text) == rule
    assert parse_fault(str(rule)) == rule


@pytest.mark.parametrize(
    ("text", "place"),
    [
        *((text, "") for text in ("", "lost=2%", "delay=1s,delay=2s")),
        *((f"delay={text}", "delay: ") for text in ("50", "-5ms")),
        *((f"silent={text}", "silent: ") for text in ("60s", "60..90")),
        ("loss=two", "loss: "),
        ("loss=200%", "loss: "),
        ("delay=1s,distribution=pareto", "distribution: "),
    ],
)
def test_words_that_are_no_rule_are_refused(text: str, place: str) -> None:
    with pytest.raises(InputError, match=f"^--fault {text}: {place}expected"):
        parse_fault(text)


def prepared(tmp_path: Path, more: str, **options: object) -> Preparation:
    """A shipped scenario with more lines at its end."""
    head = "faults_seed = 9\n" if more else ""
    folder = Folder(tmp_path, head + load_scenario("valley").text + more)
    return folder.prepare(duration="20", **options)


TABLES = """
[[faults]]
source = "plant"
signal = "dispatch"
delay_ms = 20

[[faults]]
loss = 0.01
silent = [[5, 6.5]]
"""


def test_the_rules_of_scenario_and_options_reach_the_plan_in_their_order(tmp_path: Path) -> None:
    plan = prepared(tmp_path, TABLES, faults=("loss=5%",)).plan
    assert plan.faults_seed == 9
    assert plan.faults == (
        FaultRule(source="plant", signal="dispatch", delay_ms=20.0),
        FaultRule(loss=0.01, silent=((5.0, 6.5),)),
        FaultRule(loss=0.05),
    )


def test_a_bad_rule_of_a_scenario_is_named_with_its_place(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="faults\\[2\\]: source: expected"):
        prepared(tmp_path, TABLES + "[[faults]]\nsource = 'c9'\nloss = 1\n")


TREE = ControlTree((("c1/a", 1.0), ("c1/b", 1.0), ("c2/d", 1.0)))


@pytest.mark.parametrize(
    ("rule", "named"),
    [
        ("delay=1ms,jitter=2ms,distribution=fixed", "distribution"),
        ("reorder=50%", "reorder"),
        ("silent=90s..60s", "silent"),
        ("source=c1/*", ""),
        ("source=c9/*,loss=10%", "source"),
        ("listener=recorder,loss=10%", "listener"),
        ("signal=run,loss=10%", "signal"),
        ("source=c1/a,listener=c2,loss=10%", ""),
        ("source=plant,signal=impp,loss=10%", ""),
        ("kill=plant,at=30s", ""),
        ("kill=c9,at=30s", ""),
        ("kill=c2,at=30s..40s", "at"),
        ("freeze=c2,at=30s", "at"),
        ("freeze=c2,at=40s..30s", "at"),
        ("kill=c2,at=30s,loss=2%", ""),
        ("partition=c2,at=30s..40s", "partition"),
        ("partition=c1|c2,at=30s..40s", "partition"),
        ("loss=2%,at=30s", "at"),
    ],
)
def test_a_rule_that_does_not_fit_the_run_is_refused(rule: str, named: str) -> None:
    found = complaint_of(fault_rules, load_scenario("oahu"), [rule], TREE)
    place, expected, _ = found.partition("expected")
    assert expected
    assert named in place.removeprefix(f"--fault {rule}: ")


def test_a_rule_for_what_comes_in_at_external_agents_alone_is_refused() -> None:
    def complaint(rule: str) -> str:
        return complaint_of(fault_rules, load_scenario("oahu"), [rule], TREE, ("c1/a", "c1/b"))

    assert "c1/a, c1/b" in complaint("listener=c1/*,signal=telemetry,delay=5ms")
    for rule in ("signal=telemetry,delay=5ms", "source=c1/*,delay=5ms"):
        assert fault_rules(load_scenario("oahu"), [rule], TREE, ("c1/a", "c1/b"))
