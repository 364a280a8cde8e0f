"""Controllers that die or stand still in a run in real time, and are replaced."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from running import Heliarch, assert_none_left, small_plant
from verifying import assert_equal_as_far_as_recorded, verified

from bus_schemas.signals import SETPOINT
from recordings.read.reader import RunReader

pytestmark = pytest.mark.processes

Start = Callable[..., Heliarch]


def summary_of(run: Heliarch) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((run.folder / "summary.json").read_bytes())
    return found


def incarnations(run: Heliarch, source: str) -> list[int]:
    """The cycles in which processes of a parent joined, by its setpoints."""
    with RunReader(run.folder) as reader:
        messages = [one for _, one in reader.messages(SETPOINT) if one.source == source]
    return sorted({message.incarnation for message in messages})


@pytest.mark.parametrize("victim", ["c2/inv03", "c2", "central"])
def test_a_killed_controller_is_started_again_and_the_run_goes_on(
    heliarch: Start, tmp_path: Path, victim: str
) -> None:
    scenario = small_plant(tmp_path / "plant")
    run = heliarch("launch", scenario, "--duration", "150s", "--pace", "10")
    run.until_running()
    process = run.process_of(victim)
    process.send_signal(signal.SIGKILL)
    run.until(lambda: "started again" in run.output.read_text(), "a restart")
    log = run.folder / "logs" / f"{victim.replace('/', '.')}.log"
    run.until(lambda: "joined the run in cycle" in log.read_text(), "its return")
    assert run.wait() == 0
    assert f"{victim} (process {process.pid}) was killed by signal 9" in run.output.read_text()
    assert summary_of(run)["restarts"] == {victim: 1}
    assert_none_left(run.folder)
    assert_equal_as_far_as_recorded(run, verified(run))


def test_setpoints_say_which_process_they_are_of(heliarch: Start, tmp_path: Path) -> None:
    words = ("--duration", "60s", "--pace", "10", "--fault", "kill=c2,at=20s")
    run = heliarch("launch", small_plant(tmp_path / "plant"), *words)
    assert run.wait() == 0
    first, second = incarnations(run, "c2")
    assert first == 0
    assert second >= 20


def test_a_controller_that_stands_still_is_killed_and_replaced(
    heliarch: Start, tmp_path: Path
) -> None:
    words = ("--duration", "120s", "--pace", "10", "--set", "restart.frozen_s=1")
    run = heliarch("launch", small_plant(tmp_path / "plant"), *words)
    run.until_running()
    run.process_of("c1").send_signal(signal.SIGSTOP)
    assert run.wait() == 0
    assert re.search(r"c1 \(process \d+\) says nothing: killed", run.output.read_text())
    assert "signal 9" not in run.output.read_text()
    assert summary_of(run)["restarts"] == {"c1": 1}
    assert_none_left(run.folder)


def test_a_controller_that_dies_again_and_again_ends_the_run(
    heliarch: Start, tmp_path: Path
) -> None:
    faults = [word for at in (10, 20, 30) for word in ("--fault", f"kill=c1,at={at}s")]
    words = ("--duration", "1h", "--pace", "10", "--set", "restart.most=2")
    run = heliarch("launch", small_plant(tmp_path / "plant"), *words, *faults)
    assert run.wait() == 1
    assert "c1 was started again 2 times" in run.output.read_text()
    assert "c1 (process" in run.error_text()
    assert_none_left(run.folder)


STANDBY = ("--set", 'standby=["central","supervisors"]')


@pytest.mark.parametrize("victim", ["c2", "central"])
def test_a_standby_takes_over_from_a_killed_parent_which_then_stands_by(
    heliarch: Start, tmp_path: Path, victim: str
) -> None:
    words = ("--duration", "200s", "--pace", "10", *STANDBY)
    run = heliarch("launch", small_plant(tmp_path / "plant"), *words)
    run.until_running()
    for speaker in (victim, f"{victim}+standby"):
        said = run.output.read_text().count("took over")
        run.process_of(speaker).send_signal(signal.SIGKILL)
        run.until(lambda: run.output.read_text().count("took over") > said, "a takeover")
    assert run.wait() == 0
    summary = summary_of(run)
    assert summary["takeovers"][victim] >= 2
    assert summary["restarts"] == {victim: 1, f"{victim}+standby": 1}
    assert_none_left(run.folder)
    assert_equal_as_far_as_recorded(run, verified(run))


def test_a_thawed_parent_does_not_fight_its_standby(heliarch: Start, tmp_path: Path) -> None:
    words = ("--duration", "200s", "--pace", "10", *STANDBY)
    run = heliarch("launch", small_plant(tmp_path / "plant"), *words)
    run.until_running()
    stopped = run.process_of("c1")
    stopped.send_signal(signal.SIGSTOP)
    run.until(lambda: "c1+standby took over" in run.output.read_text(), "a takeover")
    stopped.send_signal(signal.SIGCONT)
    log = run.folder / "logs" / "c1.log"
    run.until(lambda: "falls silent" in log.read_text(), "its silence")
    assert run.wait() == 0
    assert summary_of(run)["restarts"] == {}
    assert_equal_as_far_as_recorded(run, verified(run))


def test_a_standby_that_says_nothing_is_killed_and_replaced(
    heliarch: Start, tmp_path: Path
) -> None:
    words = ("--duration", "200s", "--pace", "10", "--set", "restart.frozen_s=1", *STANDBY)
    run = heliarch("launch", small_plant(tmp_path / "plant"), *words)
    run.until_running()
    run.process_of("c1+standby").send_signal(signal.SIGSTOP)
    run.until(lambda: "c1+standby (process" in run.output.read_text(), "its end")
    assert run.wait() == 0
    assert summary_of(run)["restarts"] == {"c1+standby": 1}
    assert_none_left(run.folder)
