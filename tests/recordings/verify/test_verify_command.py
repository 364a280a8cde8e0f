"""`heliarch verify`: what it prints, how it ends, what it refuses, and how a change is accepted."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from msgspec.structs import replace
from recorded_runs import AGENTS, cloudy_profile, faulty_plan, plan_of, published, record
from typer.testing import CliRunner, Result

from agents.agent import Turn
from agents.direct import DirectController
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import COMMAND, Port
from launch_scripts.cli import app
from launch_scripts.launcher import simulation
from recordings.read.run_file import RECORDING_NAME
from recordings.verify.verification import PROFILE_NAME, select_agents
from sim_plant.plant import Plant, PlantState

PLAN = plan_of(cycles=8)
PROFILE = cloudy_profile(PLAN)
PUBLISHED = published(PLAN, PROFILE)


def heliarch_verify(*words: str | Path) -> Result:
    """Run the command line in this process."""
    return CliRunner().invoke(app, ["verify", *map(str, words)])


def refused(*words: str | Path) -> str:
    """The one line with which it refuses."""
    result = heliarch_verify(*words)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    return line


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Folder of a run of two tiers in lockstep."""
    return record(tmp_path / "run", PLAN, PUBLISHED, PROFILE)


@pytest.fixture
def changed(tmp_path: Path) -> Path:
    """The same run, with another alpha in one command."""

    def change(port: Port[Message], message: Message) -> Delivery:
        if port is COMMAND.of("c2/d") and message.cycle == 3:
            return port, replace(message, alpha=0.0625)
        return port, message

    return record(tmp_path / "changed", PLAN, [change(*pair) for pair in PUBLISHED], PROFILE)


# What it says -------------------------------------------------------------------------------------


def test_an_equal_run_ends_with_status_0(run: Path) -> None:
    result = heliarch_verify(run)
    assert result.exit_code == 0, result.output
    count = len(PUBLISHED) - 2
    assert f"8 cycles, 8 agents re-run, {count} of {count + 2} messages compared" in result.stdout
    assert result.stdout.splitlines()[-1] == (
        "equal bit for bit; left out: ready_time_ns, publish_time_ns, sequence"
    )


def test_a_difference_is_shown_with_its_place_its_values_and_its_inputs(changed: Path) -> None:
    result = heliarch_verify(changed)
    assert result.exit_code == 1
    assert "c2/d: 1 differ; the first in cycle 3 (12:00:03)" in result.stdout
    assert "  c2/d/command (stage actuate): differs" in result.stdout
    assert "    alpha  recorded  0.0625\n           new       " in result.stdout
    assert "  inputs of c2/d in cycle 3" in result.stdout
    for signal in ("setpoint", "telemetry"):
        assert f"    c2/d/{signal}" in result.stdout
    assert result.stdout.splitlines()[-1].endswith("the first: c2/d/command, by c2/d in cycle 3")
    assert max(map(len, result.stdout.splitlines()[1:])) <= 100


def test_each_agent_with_a_difference_is_named(changed: Path) -> None:
    result = heliarch_verify(changed)
    # The plant obeyed the alpha that was sent, not the one that stands in the recording now.
    assert "\nplant: " in result.stdout
    assert "of 2 agents, the first: c2/d/command" in result.stdout.splitlines()[-1]


def test_a_difference_outside_the_named_agents_does_not_count(changed: Path) -> None:
    assert heliarch_verify(changed, "--node", "c1/*,c2").exit_code == 0
    assert heliarch_verify(changed, "--node", "c1/*", "--node", "c2/d").exit_code == 1


def test_what_was_allowed_does_not_count(changed: Path) -> None:
    assert heliarch_verify(changed, "--node", "c2/d", "--tolerance", "1").exit_code == 0
    assert heliarch_verify(changed, "--node", "c2/d", "--ignore", "power_kw").exit_code == 1
    assert heliarch_verify(changed, "--node", "c2/d", "--ignore", "power_kw,alpha").exit_code == 0


def test_several_runs_are_verified_one_after_the_other(run: Path, changed: Path) -> None:
    result = heliarch_verify(run, changed, "--json", "-")
    assert result.exit_code == 1
    document = json.loads(result.stdout)
    assert document["equal"] is False
    assert [entry["equal"] for entry in document["runs"]] == [True, False]


def test_the_json_has_the_difference_whole(changed: Path, tmp_path: Path) -> None:
    path = tmp_path / "outcome.json"
    assert heliarch_verify(changed, "--json", path).exit_code == 1
    (outcome,) = json.loads(path.read_text())["runs"]
    assert outcome["compared"] == len(PUBLISHED) - 2
    assert [entry["agent"] for entry in outcome["agents"]] == list(AGENTS)
    found = {entry["agent"]: entry for entry in outcome["agents"]}["c2/d"]
    assert found["differences"] == {"differs": 1}
    first = found["first"]
    assert (first["cycle"], first["stage"], first["message"]) == (3, "actuate", "c2/d/command")
    (field,) = first["fields"]
    assert (field["field"], field["recorded"]) == ("alpha", 0.0625)
    assert first["content"]["alpha"] == 0.0625
    assert first["inputs"]["c2/d/setpoint"]["source"] == "c2"


@pytest.mark.parametrize(("value", "text"), [("nan", "nan"), ("inf", "inf"), ("-inf", "-inf")])
def test_the_json_tells_numbers_that_are_none_from_null(
    value: str, text: str, tmp_path: Path
) -> None:
    def change(port: Port[Message], message: Message) -> Delivery:
        if port is COMMAND.of("c2/d") and message.cycle == 3:
            return port, replace(message, alpha=float(value))
        return port, message

    folder = record(tmp_path / "run", PLAN, [change(*pair) for pair in PUBLISHED])
    result = heliarch_verify(folder, "--node", "c2/d", "--json", "-")
    (outcome,) = json.loads(result.stdout)["runs"]
    first = outcome["agents"][0]["first"]
    assert first["fields"][0]["recorded"] == text
    assert first["content"]["alpha"] == text
    assert isinstance(first["fields"][0]["new"], float)


def test_a_full_disk_is_one_line(run: Path) -> None:
    result = heliarch_verify(run, "--json", "/dev/full")
    assert result.exit_code == 1
    assert result.stderr == "heliarch: --json /dev/full: No space left on device\n"


def test_what_was_allowed_is_named_in_the_verdict(changed: Path) -> None:
    for words, verdict in [
        (
            ["--ignore", "alpha,power_kw"],
            "equal except for alpha, power_kw, ready_time_ns, publish_time_ns, seq",
        ),
        (
            ["--tolerance", "1"],
            "equal within 1 except for ready_time_ns, publish_time_ns, sequence",
        ),
    ]:
        result = heliarch_verify(changed, "--node", "c2/d", *words)
        assert result.stdout.splitlines()[-1].startswith(verdict)


def test_a_run_in_real_time_says_how_many_inputs_were_missed(tmp_path: Path) -> None:
    plan = faulty_plan(cycles=20)
    profile = cloudy_profile(plan)
    result = heliarch_verify(record(tmp_path / "run", plan, published(plan, profile), profile))
    assert result.exit_code == 0, result.output
    assert "inputs had not come by their deadlines" in result.stdout


def test_without_the_profile_the_plant_is_left_out_and_it_is_said(run: Path) -> None:
    (run / PROFILE_NAME).unlink()
    result = heliarch_verify(run)
    assert result.exit_code == 0
    assert "7 agents re-run" in result.stdout
    assert f"plant: left out, no {PROFILE_NAME} lies beside the recording" in result.stdout


def test_a_run_that_broke_off_is_verified_as_far_as_it_goes(run: Path) -> None:
    record(run, PLAN, PUBLISHED[: len(PUBLISHED) // 2])
    result = heliarch_verify(run)
    assert result.exit_code == 0, result.output
    assert "the run or its recording broke off" in result.stdout


# What it refuses ----------------------------------------------------------------------------------


def test_an_unknown_node_is_refused_with_near_names(run: Path) -> None:
    assert "--node c1/aa: this run has no such agent, near it: c1/a" in refused(
        run, "--node", "c1/aa"
    )
    assert "near it: central" in refused(run, "--node", "centrl")
    assert "no such agent" in refused(run, "--node", "plant/*")


def test_the_plant_without_its_profile_is_refused(run: Path) -> None:
    (run / PROFILE_NAME).unlink()
    assert f"--node plant: it can be re-run if {PROFILE_NAME} lies beside" in refused(
        run, "--node", "plant"
    )


def test_the_profile_of_another_run_is_refused(run: Path) -> None:
    cloudy_profile(plan_of(cycles=9)).save(run / PROFILE_NAME)
    assert "(9, 4) cycles and inverters, expected the profile of the recorded run" in refused(run)


def test_a_recording_without_a_message_to_compare_is_refused(run: Path) -> None:
    record(run, PLAN, [PUBLISHED[0]])
    assert "nothing to verify" in refused(run)


def test_an_unknown_field_is_refused_with_near_names(run: Path) -> None:
    assert "--ignore power_kv: no message has it, accepted: power_kw" in refused(
        run, "--ignore", "power_kv"
    )
    assert "no message has it" in refused(run, "--ignore", "sequence")


@pytest.mark.parametrize("tolerance", ["-1", "nan", "inf"])
def test_a_tolerance_that_makes_no_sense_is_refused(tolerance: str, run: Path) -> None:
    assert "accepted is 0 or more" in refused(run, f"--tolerance={tolerance}")


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    assert "no such file" in refused(tmp_path / "nowhere")


def test_a_place_where_no_json_can_be_is_refused_before_the_work(tmp_path: Path, run: Path) -> None:
    assert "expected a file in an existing folder" in refused(
        run, "--json", tmp_path / "no" / "file.json"
    )


# Which agents -------------------------------------------------------------------------------------


def test_agents_are_named_by_path_and_subtrees_by_a_star() -> None:
    assert select_agents(PLAN, []) == AGENTS
    assert select_agents(PLAN, ["c2"]) == ("c2",)
    assert select_agents(PLAN, ["c2/*"]) == ("c2", "c2/c", "c2/d")
    assert select_agents(PLAN, ["c2/d", "plant", "central", "c2/*"]) == (
        "plant",
        "central",
        "c2",
        "c2/c",
        "c2/d",
    )


# Accepting a change -------------------------------------------------------------------------------


@pytest.fixture
def changed_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """Direct controllers that never command less than half."""
    right = DirectController.__init__

    def bold(self: DirectController, *words: object) -> None:
        right(self, *words)  # type: ignore[arg-type]
        self._alpha_min = 0.5

    monkeypatch.setattr(DirectController, "__init__", bold)


@pytest.mark.parametrize("method", ["__init__", "step"])
def test_code_that_fails_is_not_accepted(
    method: str, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: DirectController, *words: object) -> None:
        raise SystemExit(3)

    monkeypatch.setattr(DirectController, method, fail)
    before = (run / RECORDING_NAME).read_bytes()
    result = heliarch_verify(run, "--accept")
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line.startswith("heliarch: --accept: c1/a fails in cycle 0 (SystemExit: 3); ")
    assert (run / RECORDING_NAME).read_bytes() == before
    assert sorted(path.name for path in run.iterdir()) == [PROFILE_NAME, RECORDING_NAME]


@pytest.mark.usefixtures("changed_code")
def test_what_fails_only_as_the_run_is_made_anew_is_not_accepted(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Broken(Plant):
        def step(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
            if turn.cycle == 5:
                raise ZeroDivisionError("by hand")
            return super().step(state, turn)

    monkeypatch.setattr(simulation, "Plant", Broken)
    before = (run / RECORDING_NAME).read_bytes()
    result = heliarch_verify(run, "--accept")
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert "an agent fails: ZeroDivisionError: by hand; the recording stays as it was" in line
    assert (run / RECORDING_NAME).read_bytes() == before
    assert sorted(path.name for path in run.iterdir()) == [PROFILE_NAME, RECORDING_NAME]


@pytest.mark.usefixtures("changed_code")
def test_a_change_of_behaviour_is_accepted_on_purpose_alone(run: Path) -> None:
    before = (run / RECORDING_NAME).read_bytes()
    assert heliarch_verify(run).exit_code == 1
    assert (run / RECORDING_NAME).read_bytes() == before
    result = heliarch_verify(run, "--accept")
    assert result.exit_code == 0
    assert "NOT equal" in result.stdout, "what is accepted is shown"
    assert result.stdout.splitlines()[-1].endswith(
        "accepted, recorded anew as the agents behave now"
    )
    assert heliarch_verify(run).exit_code == 0
    assert sorted(path.name for path in run.iterdir()) == [PROFILE_NAME, RECORDING_NAME]


def test_there_is_nothing_to_accept_where_nothing_changed(run: Path) -> None:
    before = (run / RECORDING_NAME).read_bytes()
    result = heliarch_verify(run, "--accept")
    assert result.exit_code == 0
    assert result.stdout.splitlines()[-1].endswith("nothing to accept")
    assert (run / RECORDING_NAME).read_bytes() == before


def test_a_recording_that_a_simulation_cannot_make_anew_is_not_replaced(
    run: Path, tmp_path: Path
) -> None:
    plan = faulty_plan(cycles=8)
    in_real_time = record(tmp_path / "real", plan, published(plan, PROFILE), PROFILE)
    assert "recorded by launch in real time, expected a run of" in refused(in_real_time, "--accept")
    assert "accepted is no --node with it" in refused(run, "--accept", "--node", "c1")
    (run / PROFILE_NAME).unlink()
    assert f"no {PROFILE_NAME} lies beside" in refused(run, "--accept")
