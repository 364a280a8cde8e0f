"""Programs that do not belong on the bus change nothing; what they say is named and counted."""

from __future__ import annotations

from pathlib import Path

import pytest
from attacker import attacker_of
from command_line import done
from memory_runs import timeless
from running import Device, Heliarch, Start
from test_external import NODE, controller
from test_launch import summary_of

from agents.plan_file import load_plan
from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.simulation import MemoryRun
from recordings.read.reader import RunReader
from results.run_document import RunDocument
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario

pytestmark = pytest.mark.processes

LONG = "5h"
"""Plant time: in lockstep longer than any attack."""
AHEAD = 1000
"""Cycles: what is forged for a cycle to come is there before the genuine message, at any speed."""


def ended(run: Heliarch) -> RunDocument:
    """End a run with Ctrl-C."""
    run.interrupt()
    return summary_of(run.folder)


def test_a_run_without_devices_listens_where_no_other_user_can_come(
    heliarch: Start, plant: str
) -> None:
    run = heliarch("launch", plant, "--duration", LONG)
    run.until_running()
    plan = load_plan(run.folder / "plan.json")
    assert (run.folder / "plan.json").stat().st_mode & 0o077 == 0, "it is for its user alone"
    assert Path(plan.access.sockets).stat().st_mode & 0o077 == 0
    links = [link for one in run.processes() for link in one.net_connections("inet")]
    assert links == []
    ended(run)
    assert not Path(plan.access.sockets).exists()


def test_beside_a_device_what_a_stranger_forges_reaches_no_agent_and_is_named(
    heliarch: Start, device: Device, plant: str
) -> None:
    words = ("--scheme", "paper", "--duration", LONG, "--external", NODE)
    run = heliarch("launch", plant, *words)
    controller(device, run.folder)
    run.until_running()
    plan = load_plan(run.folder / "plan.json")
    with attacker_of(plan) as attacker:
        attacker.forge(run.recorded_cycles() + AHEAD, spared=NODE)
        run.until_shown(f"wrong message on {plan.plant}/c1/setpoint")
        attacker.stop_run(run.recorded_cycles())
        run.until_shown(f"wrong message on {plan.plant}/run")
        summary = ended(run)
    assert run.process.returncode == 1
    assert "more than one program sent messages on" in run.error_text()
    found = {(wrong.key, wrong.cause) for wrong in summary.launcher.wrong}
    assert {("run", "conflicting"), ("c1/setpoint", "conflicting")} <= found
    assert_right(run, plant, summary.cycles)


def assert_right(run: Heliarch, plant: str, cycles: int) -> None:
    """Assert that every message of the undisturbed run is in the recording."""
    options = RunOptions(scheme="paper", duration=LONG)
    preparation = prepare(load_scenario(plant), options, "undisturbed")
    right: set[bytes] = set()

    def hear(port: Port[Message], message: Message) -> None:
        if port.signal.decided and message.cycle < cycles:
            right.add(as_bytes(port, message))

    for cycle in MemoryRun(preparation.plan, preparation.profile, hear).cycles():
        if cycle == cycles:
            break
    with RunReader(run.folder) as reader:
        recorded = {as_bytes(port, message) for port, message in reader.messages()}
    assert len(right) > 1000
    assert right <= recorded


def as_bytes(port: Port[Message], message: Message) -> bytes:
    return str(port).encode() + encode(timeless(message))


def test_a_process_that_is_started_again_reads_renewed_certificates(
    heliarch: Start, plant: str, tmp_path: Path
) -> None:
    pytest.importorskip("cryptography")
    keys = str(tmp_path / "keys")
    done("keys", plant, "--out", keys)
    words = ("--duration", "1h", "--pace", "5", "--secure", "--keys", keys)
    run = heliarch("launch", plant, *words)
    run.until_running()
    done("keys", plant, "--out", keys, "--days", "0.0000001")
    run.process_of(NODE).kill()
    run.until_recorded(run.recorded_cycles() + 20)
    assert run.incarnations(NODE) == {0}
    done("keys", plant, "--out", keys)
    run.until_back(NODE)
    run.process_of("c1").kill()
    run.until_back("c1")
    assert ended(run).launcher.wrong == ()
