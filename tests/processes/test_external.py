"""Devices that share no code with the project, in the place of agents, as real processes."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path

import command_line
import pytest
from command_line import done
from running import REPOSITORY, Device, Start, assert_none_left
from test_launch import decided, decisions, summary_of
from wrong_device import FIRST_ABSURD

from bus_schemas.messages import Message
from recordings.verify.verification import verify
from results.run_document import RunDocument
from results.timing.report import report_on

pytestmark = pytest.mark.processes

CONTROLLER = REPOSITORY / "examples" / "direct_controller.py"
WRONG = Path(__file__).with_name("wrong_device.py")
NODE = "c1/inv01"
LOCKSTEP = ("--duration", "25", "--seed", "3", "--scheme", "paper")

Decisions = dict[tuple[str, int], Message]


def our_decisions(plant: str) -> Decisions:
    """What Heliarch's own controllers decide in the same run, in memory."""
    return decided(Path(plant).with_name("ours"), "simulate", plant, *LOCKSTEP)


def controller(device: Device, folder: Path) -> subprocess.Popen[bytes]:
    """Start the example controller; it waits for the plan of a run in a folder."""
    return device(CONTROLLER, "--plan", folder / "plan.json", "--node", NODE)


def wrong(summary: RunDocument) -> dict[tuple[str, str], int]:
    return {(entry.key, entry.cause): entry.count for entry in summary.wrong}


def test_the_example_controller_decides_bit_for_bit_what_ours_decides(
    device: Device, plant: str, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    process = controller(device, folder)
    done("launch", plant, *LOCKSTEP, "--external", NODE, "--out", folder)
    assert decisions(folder) == our_decisions(plant)
    assert process.wait(timeout=60) == 0
    summary = summary_of(folder)
    (account,) = summary.external
    assert (account.agent, account.lost, account.expected, account.answered) == (NODE, 0, 75, 75)
    assert (summary.lost, summary.wrong) == (0, ())
    found = verify(folder)
    assert found.equal
    assert NODE in found.agents
    assert_none_left(folder)


def test_in_lockstep_a_device_that_goes_away_ends_the_run_also_if_it_comes_back(
    heliarch: Start, device: Device, plant: str
) -> None:
    run = heliarch("launch", plant, "--duration", "1h", "--external", NODE)
    first = controller(device, run.folder)
    run.until_running()
    first.send_signal(signal.SIGKILL)
    run.until_shown(f"{NODE} (external) is gone in cycle")
    controller(device, run.folder)
    assert run.wait() == 1
    assert f"{NODE} is gone" in run.error_text()


def test_in_real_time_a_device_may_die_and_come_back(
    heliarch: Start, device: Device, plant: str
) -> None:
    run = heliarch("launch", plant, "--duration", "1h", "--pace", "10", "--external", NODE)
    first = controller(device, run.folder)
    run.until_running()
    first.send_signal(signal.SIGKILL)
    run.until_shown(f"{NODE} (external) is gone in cycle")
    run.until_recorded(run.recorded_cycles() + 20)
    controller(device, run.folder)
    run.until_shown(f"{NODE} (external) is back in cycle")
    run.until_back(NODE)
    run.interrupt()  # On a slow machine messages of the others may get lost: then the run says so.
    assert "the run goes on without it" in run.output.read_text()
    (account,) = summary_of(run.folder).external
    assert account.agent == NODE
    assert 0 < account.answered < account.expected


def test_a_device_that_does_everything_wrong_is_named_and_contained(
    device: Device, plant: str, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    device(WRONG, "everything", folder / "plan.json", NODE)
    result = command_line.heliarch("launch", plant, *LOCKSTEP, "--external", NODE, "--out", folder)
    assert result.exit_code == 1, "most of its messages were refused"
    output = result.stdout
    contained(decisions(folder), our_decisions(plant))
    summary = summary_of(folder)
    found = wrong(summary)
    assert found[f"{NODE}/impp", "undecodable"] == 7, "one is too large to be received"
    assert found[f"{NODE}/impp", "wrong_sender"] == 1
    assert found["c1/inv02/impp", "wrong_sender"] == 1
    assert found["c1/nobody/impp", "unknown"] == 1
    assert found[f"{NODE}/impp", "wrong_cycle"] == 1, "the other states the time of its run, too"
    of_impp = {cause: count for (key, cause), count in found.items() if key == f"{NODE}/impp"}
    assert of_impp["conflicting"] == 10 + 10_000 + 1, "twice in a cycle: each counts once"
    assert of_impp.keys() == {
        "undecodable",
        "wrong_sender",
        "wrong_cycle",
        "conflicting",
        "out_of_range",
    }
    assert found[f"{NODE}/command", "out_of_range"] == 5
    assert found[f"{NODE}/impp", "out_of_range"] == 7, "two have the time of another cycle"
    assert summary.lost_by_processes == 0
    assert "is from 'central'" in (folder / "logs" / "c1.log").read_text()
    assert f"wrong message on small/{NODE}/impp: " in output
    largest_mb = max(process.resident_mb for process in summary.processes)
    assert largest_mb < 150.0, "a flood fills no memory"
    assert verify(folder, "plant,central,c1,c2,c1/inv02").equal
    assert_none_left(folder)


def test_a_device_that_states_a_wrong_residual_ends_the_run_with_status_1(
    device: Device, plant: str, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    device(WRONG, "residual", folder / "plan.json", NODE)
    words = ("--duration", "25", "--external", NODE, "--out", folder)
    result = command_line.heliarch("launch", plant, *words)
    assert result.exit_code == 1
    assert f"{NODE}: 25 messages differ" in result.stderr
    assert list(verify(folder).first or ())[:1] == [NODE]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("late", "answers late"),
        ("late 1", "answers late"),
        ("late 2", "answers late"),
        ("silent", "missing, the first: c1/inv01/residual of cycle 10"),
        ("early", "before it sends"),
        ("ahead", "after it has sent"),
        ("jump", "before it sends"),
    ],
)
def test_a_device_that_is_late_silent_or_stamps_wrongly_is_named_and_the_status_is_1(
    device: Device, plant: str, fault: str, words: str, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    device(WRONG, fault, folder / "plan.json", NODE)
    options = ("--duration", "40", "--pace", "5", "--external", NODE, "--out", folder)
    result = command_line.heliarch("launch", plant, *options)
    assert result.exit_code == 1
    (finding,) = [line for line in summary_of(folder).external[0].timing if words in line]
    assert NODE in finding
    assert "of cycle " in finding
    assert words in result.stderr
    while_it_is = [line for line in result.stdout.splitlines() if f"{NODE}: {NODE}/" in line]
    assert bool(while_it_is) or fault in ("early", "ahead", "jump"), "named on the screen at once"
    if fault == "silent":
        assert f"{NODE}: in time again; answers were late or missing in cycles 10 to 29" in (
            result.stdout
        )
    report = report_on(folder)
    assert {one.line for one in report.budgets if not one.passed} & {
        f"late or silent {NODE}",
        f"stamps of {NODE}",
    }


def contained(launched: Decisions, right: Decisions) -> None:
    """Up to the first absurd number in place of a right one nobody decides otherwise."""
    early = {place: message for place, message in launched.items() if place[1] < FIRST_ABSURD}
    assert early == {place: right[place] for place in right if place[1] < FIRST_ABSURD}
    assert len(launched) >= len(early) > 300


def test_a_device_that_never_comes_is_named_with_where_it_should_have_come(
    plant: str, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    words = ("--external", NODE, "--external-timeout", "0.5", "--out", folder)
    ended = command_line.heliarch("launch", plant, "--duration", "20", *words)
    assert ended.exit_code == 1
    plan = json.loads((folder / "plan.json").read_text())
    failure, text = ended.stderr, ended.stdout
    assert f"no sign of {NODE} after 0.5 s" in failure
    assert str(folder / "plan.json") in failure
    for agent in ("recorder", "plant", "c1"):
        assert f"tcp/127.0.0.1:{plan['access']['tcp_ports'][agent]} ({agent})" in text
    assert f"namespace {plan['run_id']}" in text
    assert f"liveliness token small/{NODE}/alive" in text
    assert str(folder / "plan.json") in text
    assert_none_left(folder)
