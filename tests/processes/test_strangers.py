"""Programs that do not belong on the bus change nothing; what they say is named and counted."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from attacker import attacker_of
from command_line import done
from msgspec.structs import replace
from running import REPOSITORY, Heliarch, assert_none_left, small_plant
from test_launch import summary_of

from agents.plan import RunPlan, load_plan
from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.launcher.simulation import MemoryRun
from launch_scripts.launcher.summary import RunSummary
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from recordings.read.reader import RunReader

pytestmark = pytest.mark.processes

Start = Callable[..., Heliarch]
DEVICE = "c1/inv01"
LONG = "2h"
"""Plant time: in lockstep longer than any attack."""
AHEAD = 1000
"""Cycles: what is forged for a cycle to come is there before the genuine message, at any speed."""


def ended(run: Heliarch) -> RunSummary:
    """End a run with Ctrl-C."""
    run.process.send_signal(signal.SIGINT)
    run.wait()
    assert_none_left(run.folder)
    return summary_of(run.folder)


def test_nothing_that_a_stranger_says_is_heard(heliarch: Start, tmp_path: Path) -> None:
    words = ("--scheme", "paper", "--duration", LONG)
    run = heliarch("launch", small_plant(tmp_path / "plant"), *words)
    run.until_running()
    plan = load_plan(run.folder / "plan.json")
    assert (run.folder / "plan.json").stat().st_mode & 0o077 == 0, "it is for its user alone"
    with attacker_of(plan) as attacker:
        for _ in range(20):
            attacker.forge(run.recorded_cycles() + AHEAD)
            attacker.stop_run(run.recorded_cycles() + 50)
            time.sleep(0.05)
        assert not attacker.heard
    summary = ended(run)
    assert run.process.returncode == 130, run.error_text()
    assert summary.wrong == ()
    assert_right(run, summary.cycles)


def test_beside_a_device_what_a_stranger_forges_reaches_no_agent_and_is_named(
    heliarch: Start, tmp_path: Path
) -> None:
    words = ("--scheme", "paper", "--duration", LONG, "--external", DEVICE)
    run = heliarch("launch", small_plant(tmp_path / "plant"), *words)
    with example_controller(run):
        run.until_running()
        plan = load_plan(run.folder / "plan.json")
        with attacker_of(plan) as attacker:
            attacker.forge(run.recorded_cycles() + AHEAD, spared=DEVICE)
            run.until(named(run, plan, "c1/setpoint"), "news of two senders of a setpoint")
            attacker.stop_run(run.recorded_cycles())
            run.until(named(run, plan, "run"), "news of two senders of a stop")
        summary = ended(run)
    assert run.process.returncode == 1
    assert "more than one program sent messages on" in run.error_text()
    found = {(wrong.key, wrong.cause) for wrong in summary.wrong}
    assert {("run", "two senders"), ("c1/setpoint", "two senders")} <= found
    assert_right(run, summary.cycles)


def named(run: Heliarch, plan: RunPlan, key: str) -> Callable[[], bool]:
    """Whether the run has named a wrong message."""
    return lambda: f"wrong message on {plan.plant}/{key}" in run.output.read_text()


@contextmanager
def example_controller(run: Heliarch) -> Iterator[None]:
    """The example in the place of a device, for as long as the context lasts."""
    program = REPOSITORY / "examples" / "direct_controller.py"
    words = ("--plan", str(run.folder / "plan.json"), "--node", DEVICE)
    process = subprocess.Popen([sys.executable, str(program), *words])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def assert_right(run: Heliarch, cycles: int) -> None:
    """Assert that every message of the undisturbed run is in the recording."""
    scenario = load_scenario(str(run.folder.parent / "plant" / "small.toml"))
    preparation = prepare(scenario, RunOptions(scheme="paper", duration=LONG), "undisturbed")
    right: set[bytes] = set()

    def hear(port: Port[Message], message: Message) -> None:
        if port.signal.decided and message.cycle < cycles:
            right.add(timeless(port, message))

    for cycle in MemoryRun(preparation.plan, preparation.profile, hear).cycles():
        if cycle == cycles:
            break
    with RunReader(run.folder) as reader:
        recorded = {timeless(port, message) for port, message in reader.messages()}
    assert len(right) > 1000
    assert right <= recorded


def timeless(port: Port[Message], message: Message) -> bytes:
    return str(port).encode() + encode(replace(message, publish_time_ns=0, ready_time_ns=0))


def test_with_its_keys_a_plant_runs_as_without(tmp_path: Path) -> None:
    pytest.importorskip("cryptography")
    plant, keys = small_plant(tmp_path / "plant"), str(tmp_path / "keys")
    done("keys", plant, "--out", keys)
    done("launch", plant, "--duration", "20", "--secure", "--keys", keys, "--out", tmp_path / "run")
    summary = summary_of(tmp_path / "run")
    assert (summary.cycles, summary.wrong) == (20, ())
    assert_none_left(tmp_path / "run")
