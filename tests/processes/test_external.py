"""Devices that share no code with the project, in the place of agents, as real processes."""

from __future__ import annotations

import json
import re
import signal
import subprocess
from pathlib import Path

import command_line
import pytest
from command_line import done
from running import REPOSITORY, Device, Start, assert_none_left
from test_launch import decided, decisions, summary_of

from bus_schemas.messages import Message
from recordings.verify.verification import verify
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


IN_LOCKSTEP = {
    "garbage": f"{NODE}/impp undecodable",
    "a field less": f"{NODE}/impp undecodable",
    "text for a number": f"{NODE}/impp undecodable",
    "cycle ahead": f"{NODE}/impp out_of_range",
    "contradiction": f"{NODE}/impp conflicting",
    "flood": f"{NODE}/impp conflicting",
    "name of another": f"{NODE}/impp wrong_sender",
    "key of another": "c1/inv02/impp: in cycle ",
    "unknown key": "c1/nobody/impp: in cycle ",
    "not a number": f"{NODE}/impp out_of_range",
    "beyond the rating": f"{NODE}/impp out_of_range",
    "no alpha": f"{NODE}/command out_of_range",
    "residual": f"messages differ from what it must decide, the first: {NODE}/residual",
}
IN_REAL_TIME = {
    "late": "answers late, 0 missing, the first: c1/inv01/",
    "late 1": "answers late",
    "late 2": "answers late",
    "silent": f"missing, the first: {NODE}/residual of cycle 5",
    "early": "before it sends",
    "ahead": "after it has sent",
    "jump": "before it sends",
}


@pytest.mark.parametrize(("fault", "words"), [*IN_LOCKSTEP.items(), *IN_REAL_TIME.items()])
def test_a_device_that_misbehaves_is_named_with_key_and_cycle_and_the_status_is_1(
    device: Device, plant: str, fault: str, words: str, tmp_path: Path
) -> None:
    folder, in_lockstep = tmp_path / "run", fault in IN_LOCKSTEP
    device(WRONG, fault, folder / "plan.json", NODE)
    options = ("--duration", "10") if in_lockstep else ("--duration", "28", "--pace", "5")
    command = ("launch", plant, *options, "--external", NODE, "--out", folder)
    result = command_line.heliarch(*command)
    assert result.exit_code == 1, result.output
    (failure,) = [line for line in result.stderr.splitlines() if words in line]
    assert NODE in failure
    assert re.search(r"/\w+ .*cycle \d+|/\w+: in cycle \d+", failure)
    if in_lockstep:  # What it sends in vain disturbs nobody.
        assert verify(folder, "plant,central,c1,c2,c1/inv02").equal
        (log,) = (folder / "logs").glob("c1.log")
        assert log.stat().st_size < 20_000, "a flood fills no disk"
        return
    report = report_on(folder)
    assert {one.line for one in report.budgets if not one.passed} & {
        f"late or silent {NODE}",
        f"stamps of {NODE}",
    }
    while_it_is = [line for line in result.stdout.splitlines() if f"{NODE}: {NODE}/" in line]
    assert bool(while_it_is) or fault in ("early", "ahead", "jump"), "named on the screen at once"
    if fault == "silent":
        assert f"{NODE}: in time again; answers were late or missing in cycles 5 to 24" in (
            result.stdout
        )


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
