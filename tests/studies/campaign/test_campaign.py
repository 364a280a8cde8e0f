"""Campaigns of random faults: they hold, they repeat, and they find bugs that were planted."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from command_line import done, heliarch
from planted_bugs import BUGS, OF_FRACTIONS, Patch

from agents.faults import Freeze, Kill, Trip
from agents.plan import RunPlan
from bus_schemas.faults import Blackout, Disturbance, Partition
from scenarios.fault_rules import fault_text, parse_fault
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario
from studies.campaign.study import Campaign, campaign, faults_of, run_seed

PROJECT = Path(__file__).parents[3]
FIRST_BROKEN_SEED = Path(__file__).with_name("first_broken_seed.py")


@pytest.fixture(scope="module")
def oahu() -> Campaign:
    return campaign(prepare(load_scenario("oahu"), RunOptions(duration="150s"), "campaign"))


def test_seeds_hold_and_repeat(oahu: Campaign) -> None:
    results = [run_seed(oahu, seed) for seed in range(6)]
    assert [result.violations for result in results] == [()] * 6
    assert any(result.under_kwh > 0.0 for result in results)
    assert run_seed(oahu, 5) == results[5]


def test_faults_of_all_kinds_outlast_every_time_out_and_are_written_as_rules(
    oahu: Campaign,
) -> None:
    plan: RunPlan = oahu.plan
    drawn = [fault for seed in range(1, 101) for fault in faults_of(plan, seed)[0]]
    assert {type(one) for one in drawn} == {Kill, Freeze, Trip, Partition, Blackout, Disturbance}
    assert [parse_fault(fault_text(fault)) for fault in drawn] == drawn
    ends = [(one.at, one.until or 0.0) if isinstance(one, Kill) else one.at for one in drawn]
    assert sum(at is not None and at[1] - at[0] > 65.0 for at in ends) > 10
    assert any(isinstance(one, Freeze) and one.zombie for one in drawn)
    assert any(faults_of(plan, seed)[1] for seed in range(20)), "some parents have standbys"


def planted(folder: Path, patches: Sequence[Patch]) -> Path:
    """Copy the packages and patch the copy; each patch must apply in one place."""
    ignored = shutil.ignore_patterns("__pycache__", "golden")
    for package in PROJECT.glob("*/__init__.py"):
        if package.parent.name != "tests":
            shutil.copytree(package.parent, folder / package.parent.name, ignore=ignored)
    for file, old, new in patches:
        text = (folder / file).read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{file} has {old!r} {text.count(old)} times"
        (folder / file).write_text(text.replace(old, new), encoding="utf-8")
    return folder


@pytest.mark.parametrize("bug", BUGS)
def test_the_patch_of_a_planted_bug_applies(bug: str) -> None:
    for file, old, _ in BUGS[bug]:
        assert (PROJECT / file).read_text(encoding="utf-8").count(old) == 1


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("bug", BUGS)
def test_a_planted_bug_is_found_by_seeds_1_to_300(
    bug: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = planted(tmp_path / "code", BUGS[bug])
    actuator = "fraction" if bug in OF_FRACTIONS else "limit"
    words = [sys.executable, str(FIRST_BROKEN_SEED), "oahu", "150s", "1..300", actuator]
    answer = subprocess.run(
        words, env={"PYTHONPATH": str(code)}, cwd=code, capture_output=True, check=True, text=True
    )
    found = json.loads(answer.stdout)
    assert found["code"] == str(code)
    with capsys.disabled():
        print(f"\n| {bug} | {found['seed']} | {', '.join(found['invariants'])} |")
    assert found["seed"], "no seed found it"


def test_a_broken_seed_is_shrunk_and_a_command_repeats_its_run(tmp_path: Path) -> None:
    code = planted(tmp_path / "code", BUGS["a silent child counts 0"])
    words = [sys.executable, "-m", "heliarch", "campaign", "oahu", "--seeds", "4"]
    words += ["--data", str(tmp_path), "--from", "12:30"]
    answer = subprocess.run(
        words, env={"PYTHONPATH": str(code)}, cwd=code, capture_output=True, text=True, check=False
    )
    assert answer.returncode == 1, answer.stderr
    (command, *_) = re.findall(r"^ +heliarch (simulate .*)$", answer.stdout, re.MULTILINE)
    assert command.count("--fault") == 1
    assert f"--from 12:30 --data {tmp_path}" in command
    said = done(*shlex.split(command), "--out", tmp_path / "run")
    assert "acted" in said


def test_faults_of_the_scenario_itself_are_part_of_every_seed(tmp_path: Path) -> None:
    text = (PROJECT / "scenarios" / "shipped" / "oahu.toml").read_text(encoding="utf-8")
    text += '\n[[faults]]\nkind = "trip"\nagents = "c1/*"\nat = [20, 40]\n'
    scenario = tmp_path / "tripping.toml"
    scenario.write_text(text.replace('"oahu.csv"', f'"{PROJECT}/scenarios/shipped/oahu.csv"'))
    result = heliarch("campaign", scenario, "--seeds", "0", "--json", "-")
    assert result.exit_code == 0, result.output
    (seed,) = json.loads(result.stdout)
    assert seed["under_kw"] > 500.0
