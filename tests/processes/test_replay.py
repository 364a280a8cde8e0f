"""Replays over real Zenoh: what a subscriber hears, and live agents among recorded ones."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgpack
import pytest
import zenoh
from command_line import done
from mcap.reader import make_reader
from plans_by_hand import with_changes
from recordings_by_hand import write_messages
from running import Start, assert_none_left, small_plant

from agents.plan import RunPlan, load_plan
from bus_schemas.signals import TELEMETRY
from recordings.read.reader import RunReader

pytestmark = pytest.mark.processes


CYCLES = 30
PATIENCE_S = 120.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run in lockstep: four inverters, two clusters."""
    folder = tmp_path_factory.mktemp("recorded")
    done("simulate", small_plant(folder), "--duration", str(CYCLES), "--out", folder / "run")
    return folder / "run"


@pytest.fixture(scope="module")
def plan(recorded: Path) -> RunPlan:
    return load_plan(recorded / "plan.json")


@pytest.fixture(scope="module")
def real_time(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of the same plant on a clock, whose links delay all messages."""
    folder = tmp_path_factory.mktemp("real-time")
    words = ("--duration", "60", "--pace", "5", "--fault", "delay=1ms", "--out", folder / "run")
    done("simulate", small_plant(folder), *words)
    return folder / "run"


@contextmanager
def subscriber(endpoint: str, key: str, mode: str = "peer") -> Iterator[list[tuple[str, bytes]]]:
    """Anybody with Zenoh: what comes on some keys, in its order."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    heard: list[tuple[str, bytes]] = []
    with zenoh.open(config) as session:
        session.declare_subscriber(
            key, lambda sample: heard.append((str(sample.key_expr), sample.payload.to_bytes()))
        )
        yield heard


def until(condition: Callable[[], bool]) -> None:
    """Wait for something to come true."""
    give_up_at = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_at
        time.sleep(0.02)


def in_the_file(folder: Path, plan: RunPlan, *signals: str) -> list[tuple[str, bytes]]:
    """Keys and payloads of a recording, read with the MCAP library alone."""
    with (folder / "run.mcap").open("rb") as file:
        return [
            (f"{plan.run_id}/{channel.topic}", message.data)
            for _, channel, message in make_reader(file).iter_messages()
            if not signals or channel.topic.rpartition("/")[2] in signals
        ]


@pytest.mark.parametrize(
    ("mode", "words", "signals"),
    [
        ("peer", ("--pace", "10"), ()),
        ("client", ("--pace", "max", "--signals", "impp,help"), ("impp", "help")),
    ],
)
def test_any_subscriber_hears_the_recorded_bytes_in_their_order_and_where_the_replay_stands(
    heliarch: Start,
    recorded: Path,
    plan: RunPlan,
    mode: str,
    words: tuple[str, ...],
    signals: tuple[str, ...],
) -> None:
    replay = heliarch("replay", recorded, "--wait", *words)
    endpoint, keys = replay.until_said("endpoint"), replay.until_said("keys")
    wanted = in_the_file(recorded, plan, *signals)
    with subscriber(endpoint, keys, mode) as heard:
        assert replay.wait() == 0, replay.error_text()
        until(lambda: len(heard) >= len(wanted) + CYCLES)
    assert [entry for entry in heard if not entry[0].endswith("/clock")] == wanted
    clocks = [msgpack.unpackb(payload) for key, payload in heard if key.endswith("/clock")]
    assert [clock["cycle"] for clock in clocks][:CYCLES] == list(range(CYCLES))
    assert clocks[7]["sim_time_ns"] == plan.timing.sim_time_ns(7)


def test_keys_steer_a_replay_and_the_terminal_is_left_as_it_was(recorded: Path) -> None:
    typing, terminal = pty.openpty()
    before = termios.tcgetattr(terminal)
    words = [sys.executable, "-m", "heliarch", "replay", str(recorded), "--start-paused"]
    process = subprocess.Popen(words, stdin=terminal, stdout=terminal, stderr=terminal)
    seen = ""
    try:
        for awaited, keys in (
            ("space pauses", b" "),
            ("12:00:01 cycle 1 of", b" "),
            (" paused", b"q"),
            ("replayed ", b""),
        ):
            while awaited not in seen:
                seen += os.read(typing, 4096).decode()
            seen = seen.partition(awaited)[2]
            os.write(typing, keys)
        assert process.wait(timeout=PATIENCE_S) == 0
        assert termios.tcgetattr(terminal) == before
    finally:
        process.kill()
        process.wait()
        os.close(typing)
        os.close(terminal)


def some_live(plan: RunPlan) -> tuple[str, str]:
    """An inverter's controller and a supervisor of another cluster."""
    return plan.tree.leaves[0], next(
        node for node in plan.tree.parents[1:] if not plan.tree.leaves[0].startswith(f"{node}/")
    )


@pytest.mark.parametrize("broke_off", [False, True])
def test_live_agents_of_the_same_code_say_bit_for_bit_what_they_said(
    heliarch: Start, recorded: Path, plan: RunPlan, tmp_path: Path, broke_off: bool
) -> None:
    live, cycles = some_live(plan), CYCLES
    if broke_off:
        with RunReader(recorded) as reader:
            left = [(port, message) for port, message in reader.messages() if message.cycle < 20]
        write_messages(tmp_path / "run.mcap", left, plan=plan)
        recorded, cycles = tmp_path, 19 - plan.control.periods.longest
    replay = heliarch("replay", recorded, "--live", ",".join(live), "--json", "-")
    assert replay.wait() == 0, replay.error_text()
    figures = json.loads(replay.output.read_text())
    with RunReader(recorded) as reader:
        said = sum(m.cycle < cycles for port, m in reader.messages() if port.publisher in live)
    assert (figures["compared"], figures["differing"]) == (said, {})
    assert figures["cycles"] == cycles
    assert replay.processes() == []
    assert list(replay.folder.iterdir()) == []


def test_a_changed_controller_is_told_by_its_first_difference_and_heard_by_subscribers(
    heliarch: Start, recorded: Path, plan: RunPlan, tmp_path: Path
) -> None:
    leaf, _ = some_live(plan)
    changed = tmp_path / "changed.json"
    # The plan of a launched run has a secret, which the live controllers do not need.
    its_plan = with_changes(plan, scheme="paper", secret="s", users_file="users")
    changed.write_bytes(its_plan.as_json())
    figures_path = tmp_path / "figures.json"
    words = ("--wait", "--live", leaf, "--plan", changed, "--json", figures_path)
    replay = heliarch("replay", recorded, *words)
    endpoint = replay.until_said("endpoint")
    with subscriber(endpoint, f"{plan.run_id}/{plan.plant}/{leaf}/impp") as heard:
        assert replay.wait() == 1, replay.error_text()
        until(lambda: len(heard) == CYCLES)
    figures = json.loads(figures_path.read_bytes())
    (account,) = figures["agents"]
    first = account["first"]
    assert figures["differing"] == {leaf: account["differences"]["differs"]}
    assert (first["kind"], first["message"]) == ("differs", f"{leaf}/impp")
    with RunReader(recorded) as reader:
        recorded_kw = {m.cycle: m.power_kw for _, m in reader.messages("impp", nodes=leaf)}  # type: ignore[attr-defined]
    heard_kw = {m["cycle"]: m["power_kw"] for m in (msgpack.unpackb(p) for _, p in heard)}
    assert heard_kw.keys() == recorded_kw.keys()
    differing = [cycle for cycle, power_kw in heard_kw.items() if power_kw != recorded_kw[cycle]]
    assert min(differing) == first["cycle"]
    (field,) = first["fields"]
    cycle = first["cycle"]
    assert (field["recorded"], field["new"]) == (recorded_kw[cycle], heard_kw[cycle])
    assert str(field["new"]) in replay.output.read_text()


def test_who_waits_for_what_the_recording_lacks_is_named(
    heliarch: Start, recorded: Path, plan: RunPlan, tmp_path: Path
) -> None:
    leaf, cluster = some_live(plan)
    impatient = with_changes(plan, stall_timeout_s=1.0)
    with RunReader(recorded) as reader:
        left = [
            (port, message)
            for port, message in reader.messages()
            if not (port is TELEMETRY.of(leaf) and message.cycle == 7)
        ]
    write_messages(tmp_path / "run.mcap", left, plan=impatient)
    replay = heliarch("replay", tmp_path, "--live", f"{leaf},{cluster}")
    assert replay.wait() == 1
    complaint = replay.error_text()
    assert "stalled in cycle 7" in complaint
    assert "from plant" in complaint
    assert f"{leaf} waits for {leaf}/telemetry" in complaint
    assert str(replay.folder) in complaint, "the logs stay"
    assert replay.processes() == []


def test_no_live_agent_outlives_its_replay(heliarch: Start, recorded: Path, plan: RunPlan) -> None:
    replay = heliarch("replay", recorded, "--live", ",".join(plan.tree.agents()[2:]))
    replay.until(lambda: len(replay.processes()) > 3, "its processes")
    replay.process.send_signal(signal.SIGKILL)
    replay.wait()
    assert_none_left(replay.folder)


def test_in_real_time_live_agents_have_the_pace_of_the_run_and_ctrl_c_keeps_what_was_compared(
    heliarch: Start, plan: RunPlan, real_time: Path, tmp_path: Path
) -> None:
    leaf, _ = some_live(plan)
    file = tmp_path / "figures.json"
    replay = heliarch("replay", real_time, "--live", leaf, "--json", file)
    replay.until(lambda: replay.output.read_text().count("12:00:") > 3, "some cycles")
    assert replay.interrupt() == 130, replay.error_text()
    figures = json.loads(file.read_bytes())
    assert figures["interrupted"]
    assert 0 < figures["cycles"] < 60
    assert figures["compared"] >= figures["cycles"]
    assert figures["wall_s"] > 0.2 * (figures["cycles"] - 1)
