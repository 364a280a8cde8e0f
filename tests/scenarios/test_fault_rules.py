"""The rules of `--fault` and of a scenario: read, checked against the run, refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from complaints import complaint_of
from own_scenarios import Folder

from agents.faults import Fault, Freeze, Kill, Trip
from bus_schemas.faults import Blackout, Disturbance, Partition
from bus_schemas.tree import ControlTree
from scenarios.fault_rules import fault_rules, fault_text, parse_fault
from scenarios.scenario import load_scenario

TREE = ControlTree((("c1/a", 1.0), ("c1/b", 1.0), ("c2/d", 1.0)))


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("delay=0.05s, listener=central", Disturbance(listener="central", delay_ms=50.0)),
        ("loss=0.5%", Disturbance(loss=0.005)),
        ("loss=0.125,duplicate=1", Disturbance(loss=0.125, duplicate=1.0)),
        ("reorder=10%,reorder-by=1500ms", Disturbance(reorder=0.1, reorder_ms=1500.0)),
        ("source=c1,blackout=2m..0.05h", Blackout(source="c1", at=(120.0, 180.0))),
        ("delay=1s,distribution=normal", Disturbance(delay_ms=1000.0, distribution="normal")),
        ("loss=1,at=1s..2s", Disturbance(loss=1.0, at=(1.0, 2.0))),
        ("kill=c2,at=30s", Kill("c2", 30.0)),
        ("freeze=c2,at=1s..2.5s", Freeze("c2", (1.0, 2.5))),
        ("trip=c1/*,at=1s..2s", Trip("c1/*", (1.0, 2.0))),
        ("partition=c1|central", Partition(("c1", "central"))),
        ("partition=c1|central,at=30s..60s", Partition(("c1", "central"), (30.0, 60.0))),
    ],
)
def test_the_words_of_an_option_become_a_rule_and_name_it(text: str, rule: Fault) -> None:
    assert parse_fault(text) == rule
    assert parse_fault(fault_text(rule)) == rule


@pytest.mark.parametrize(
    ("text", "place"),
    [
        *((text, "") for text in ("", "lost=2%", "delay=1s,delay=2s")),
        *((f"delay={text}", "delay: ") for text in ("50", "-5ms")),
        *((f"blackout={text}", "blackout: ") for text in ("60s", "60")),
        ("loss=two", "loss: "),
        ("loss=200%", "loss: "),
        ("delay=1s,distribution=pareto", "distribution: "),
        ("kill=c1,at=3s,loss=2%", "loss: "),
        ("blackout=1s..2s,at=3s..4s", "at: "),
        ("kill=c1,blackout=1s..2s", ""),
    ],
)
def test_words_that_are_no_rule_are_refused(text: str, place: str) -> None:
    assert complaint_of(parse_fault, text).startswith(f"--fault {text}: {place}expected")


def test_the_rules_of_scenario_and_options_reach_the_plan_in_their_order(tmp_path: Path) -> None:
    kill = "[[faults]]\nkind = 'kill'\nagents = 'z1/c1'\nat = 5\n"
    folder = Folder(tmp_path, f"faults_seed = 9\n{load_scenario('valley').text}\n{kill}")
    faults = folder.prepare(duration="20", faults=("loss=5%",)).plan.faults
    assert (faults.seed, faults.rules) == (9, (Kill("z1/c1", 5.0), Disturbance(loss=0.05)))
    folder.change(kill, f"{kill}\n[[faults]]\nkind = 'blackout'\nsource = 'c9'\nat = [1, 2]\n")
    assert "faults[1]: source: expected" in folder.complaint(duration="20")


def complaint(rule: str, *more: object) -> str:
    return complaint_of(fault_rules, load_scenario("oahu"), [rule], TREE, *more)


@pytest.mark.parametrize(
    ("rule", "named"),
    [
        ("delay=1ms,jitter=2ms,distribution=fixed", "distribution"),
        ("reorder=50%", "reorder"),
        ("blackout=90s..60s", "at"),
        ("source=c1/*", ""),
        ("source=c9/*,loss=10%", "source"),
        ("listener=recorder,loss=10%", "listener"),
        ("signal=run,loss=10%", "signal"),
        ("source=c1/a,listener=c2,loss=10%", ""),
        ("source=plant,signal=impp,loss=10%", ""),
        ("kill=plant,at=30s", ""),
        ("kill=c9,at=30s", ""),
        ("kill=c2,at=30s..40s", "at"),
        ("trip=c2,at=30s..40s", ""),
        ("freeze=c2,at=30s", "at"),
        ("freeze=c2,at=40s..30s", "at"),
        ("partition=c2,at=30s..40s", "between"),
        ("partition=c1|c2,at=30s..40s", ""),
        ("loss=2%,at=30s", "at"),
    ],
)
def test_a_rule_that_does_not_fit_the_run_is_refused(rule: str, named: str) -> None:
    place, expected, _ = complaint(rule).partition("expected")
    assert expected
    assert named in place.removeprefix(f"--fault {rule}: ")


def test_inputs_of_devices_and_processes_elsewhere_are_beyond_a_rule() -> None:
    scenario, devices = load_scenario("oahu"), ("c1/a", "c1/b")
    assert "c1/a, c1/b" in complaint("listener=c1/*,signal=telemetry,delay=5ms", devices)
    for rule in ("signal=telemetry,delay=5ms", "source=c1/*,delay=5ms"):
        assert fault_rules(scenario, [rule], TREE, devices)
    there = ("c1", *devices)
    found = complaint("kill=c1/*,at=3s", (), there)
    assert "this host" in found
    assert "c1/*" in found
    assert fault_rules(scenario, ["listener=c1/a,delay=5ms"], TREE, (), there)
