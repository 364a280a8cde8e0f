"""Controllers that die or stand still in a run in real time, and are replaced."""

from __future__ import annotations

import re
import signal
from collections.abc import Sequence
from pathlib import Path

import pytest
from running import Heliarch, Start, small_plant
from test_launch import summary_of
from verifying import assert_equal_as_far_as_recorded

from agents.plan_file import load_plan
from recordings.read.run_file import log_name
from recordings.verify.verification import verify

pytestmark = pytest.mark.processes


def until_joined(run: Heliarch, process: str) -> None:
    log = run.folder / "logs" / log_name(process)
    run.until(lambda: log.exists() and "joined the run in" in log.read_text(), "its return")


def ended(run: Heliarch) -> None:
    """End a run after the cycle under way."""
    assert run.interrupt() == 130, run.error_text()


REAL_TIME = ("--duration", "1h", "--pace", "10")
LOCKSTEP = ("--duration", "2h", "--set", "restart.when=on-failure")
VICTIMS = ("c2/inv03", "c2", "central")
GROUPED = ("--set", "processes=cluster")


@pytest.mark.parametrize("words", [REAL_TIME, LOCKSTEP])
@pytest.mark.parametrize(("grouped", "victims"), [((), VICTIMS), (GROUPED, ("c2",))])
def test_killed_controllers_are_started_again_with_all_of_their_process_and_the_run_goes_on(
    heliarch: Start,
    plant: str,
    words: Sequence[str],
    grouped: Sequence[str],
    victims: Sequence[str],
) -> None:
    run = heliarch("launch", plant, *words, *grouped)
    run.until_recorded()
    for victim in victims:
        process = run.process_of(victim)
        process.send_signal(signal.SIGKILL)
        until_joined(run, victim)
        assert f"{victim} (process {process.pid}) was killed by signal 9" in run.output.read_text()
        run.until_recorded(run.recorded_cycles() + 1)
    wiring = load_plan(run.folder / "plan.json").wiring
    agents = [agent for victim in victims for agent in wiring.members[victim]]
    for agent in agents:
        run.until_back(agent)
    ended(run)
    assert summary_of(run.folder).restarts == dict.fromkeys(agents, 1)
    assert_equal_as_far_as_recorded(run, verify(run.folder))


# Controllers that run and say nothing -------------------------------------------------------------

IMPATIENT = ("--set", "restart.frozen_s=1")
HANG = """
from pathlib import Path
from agents.parent import Supervisor

step = Supervisor.step

def stuck(self, state, turn):
    if self.name == "c1" and turn.cycle >= 20 and not Path(FLAG).exists():
        Path(FLAG).touch()
        while True:
            pass
    return step(self, state, turn)

Supervisor.step = stuck
"""


@pytest.mark.parametrize(
    "words", [(*REAL_TIME, *IMPATIENT), ("--duration", "2h", "--set", "restart.when=always")]
)
def test_a_controller_that_is_busy_for_ever_is_killed_and_replaced(
    heliarch: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: Sequence[str]
) -> None:
    code = HANG.replace("FLAG", repr(str(tmp_path / "flag")))
    (tmp_path / "sitecustomize.py").write_text(code, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    soon = ("stall_timeout_s = 60", "stall_timeout_s = 3")
    run = heliarch("launch", small_plant(tmp_path / "plant", soon), *words)
    until_joined(run, "c1")
    run.until_recorded(40)
    ended(run)
    killed = re.findall(r"^(\S+) .process \d+. (.*): killed", run.output.read_text(), re.MULTILINE)
    assert [(name, why.startswith("has not beaten")) for name, why in killed] == [("c1", True)]
    assert_equal_as_far_as_recorded(run, verify(run.folder))
