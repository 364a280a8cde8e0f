"""`heliarch verify`: what it prints, how it ends, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import heliarch, refusal
from junitparser import JUnitXml, Skipped
from msgspec.structs import replace
from recorded_runs import AGENTS, cloudy_profile, plan_of, published, record

from sim_plant.profile import PROFILE_NAME

PLAN = plan_of(cycles=8)
PROFILE = cloudy_profile(PLAN)
PUBLISHED = published(PLAN, PROFILE)
DECIDED = len(PUBLISHED) - 2


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Folder of a run of two tiers in lockstep."""
    return record(tmp_path / "run", PLAN, PUBLISHED, PROFILE)


@pytest.fixture
def changed(tmp_path: Path) -> Path:
    """Folder of the same run, with another alpha in one command."""
    messages = [
        (port, replace(message, alpha=0.0625) if place == ("c2/d/command", 3) else message)
        for port, message in PUBLISHED
        for place in [(str(port), message.cycle)]
    ]
    return record(tmp_path / "changed", PLAN, messages, PROFILE)


def outcome_of(*words: str | Path) -> tuple[int, dict[str, Any]]:
    """Exit status and JSON of one run."""
    result = heliarch("verify", *words, "--json", "-")
    (outcome,) = json.loads(result.stdout)["runs"]
    assert isinstance(outcome, dict)
    return result.exit_code, outcome


def test_an_equal_run_ends_with_status_0(run: Path) -> None:
    status, outcome = outcome_of(run)
    assert (status, outcome["equal"]) == (0, True)
    assert outcome["compared"] == outcome["asked"] == DECIDED
    assert [entry["agent"] for entry in outcome["agents"]] == list(AGENTS)


def test_a_difference_is_found_with_its_place_its_values_and_its_inputs(changed: Path) -> None:
    status, outcome = outcome_of(changed)
    assert (status, outcome["first_agent"]) == (1, "c2/d")
    # The plant obeyed the alpha that was sent, not the one that stands in the recording now.
    different = {entry["agent"]: entry for entry in outcome["agents"] if entry["first"]}
    assert set(different) == {"plant", "c2/d"}
    assert different["c2/d"]["differences"] == {"differs": 1}
    first = different["c2/d"]["first"]
    assert (first["cycle"], first["stage"], first["message"]) == (3, "actuate", "c2/d/command")
    (field,) = first["fields"]
    assert (field["field"], field["recorded"]) == ("alpha", 0.0625)
    assert first["inputs"]["c2/d/setpoint"]["source"] == "c2"
    result = heliarch("verify", changed)
    for text in ("cycle 3", "12:00:03", "c2/d/command", "alpha", "0.0625", str(field["new"])):
        assert text in result.stdout


@pytest.mark.parametrize("words", ["--nodes c1/*,c2", "--nodes c2/d --tolerance 1"])
def test_allowed_and_unselected_differences_do_not_count(words: str, changed: Path) -> None:
    found, outcome = outcome_of(changed, *words.split())
    assert (found, outcome["cycles"]) == (0, 8)
    asked_for = {agent["agent"] for agent in outcome["agents"]}
    assert outcome["compared"] == sum(port.publisher in asked_for for port, _ in PUBLISHED)


def test_equal_is_said_of_a_run_of_which_all_was_compared_and_of_no_other(run: Path) -> None:
    result = heliarch("verify", run)
    assert result.stdout.splitlines()[-1].startswith("equal bit for bit: ")
    (run / PROFILE_NAME).unlink()
    own = sum(port.publisher != "plant" for port, _ in PUBLISHED)
    status, outcome = outcome_of(run)
    assert (status, outcome["equal"], outcome["differences"]) == (1, False, 0)
    assert (outcome["compared"], outcome["asked"]) == (own, DECIDED)
    assert outcome["share"] == pytest.approx(own / DECIDED)
    junit = run / "verify.xml"
    last = heliarch("verify", run, "--junit", junit).stdout.splitlines()[-1]
    (suite,) = JUnitXml.fromfile(str(junit))
    cases = {case.name: [type(one) for one in case.result] for case in suite}
    assert cases == {name: [Skipped] if name == "plant" else [] for name in AGENTS}
    assert last.startswith("equal as far as compared (")
    assert outcome_of(run, "--nodes", "central/*")[0] == 0, "all that was asked for"
    record(run, PLAN, [pair for pair in PUBLISHED if str(pair[0]) != "c2/d/command"])
    assert heliarch("verify", run).stdout.splitlines()[-1].startswith("NOT whole")
    record(run, PLAN, [pair for pair in PUBLISHED if pair[0].publisher == "c2/d"])
    assert outcome_of(run)[0] == 1


def test_a_recording_that_cannot_be_verified_is_refused(run: Path) -> None:
    cloudy_profile(plan_of(cycles=200)).save(run / PROFILE_NAME)
    assert "larger" in refusal("verify", run), "it is not unpacked"
    cloudy_profile(plan_of(cycles=9)).save(run / PROFILE_NAME)
    assert "(9, 4)" in refusal("verify", run), "the profile of another run"
    (run / PROFILE_NAME).unlink()
    assert list(outcome_of(run)[1]["left_out"]) == ["plant"], "what is in none is left out"
    assert PROFILE_NAME in refusal("verify", run, "--nodes", "plant")
    record(run, PLAN, [PUBLISHED[0]])
    assert "got none" in refusal("verify", run)
