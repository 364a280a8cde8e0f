"""Replays over real Zenoh: what a subscriber hears, and live agents among recorded ones."""

from __future__ import annotations

import json
import shlex
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgpack
import pytest
import zenoh
from command_line import done
from mcap.reader import make_reader
from running import Start, small_plant

from agents.plan import RunPlan
from agents.plan_file import load_plan

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


@pytest.fixture
def started() -> Iterator[Callable[[str], None]]:
    """Runs commands that a replay prints; all of them end with the test."""
    processes: list[subprocess.Popen[bytes]] = []
    yield lambda command: processes.append(subprocess.Popen(shlex.split(command)))
    for process in processes:
        process.kill()
        process.wait()


@pytest.mark.parametrize("run", ["recorded", "real_time"])
def test_agents_left_out_take_part_by_the_printed_commands(
    heliarch: Start,
    run: str,
    plan: RunPlan,
    started: Callable[[str], None],
    request: pytest.FixtureRequest,
) -> None:
    folder: Path = request.getfixturevalue(run)
    leaf = plan.tree.leaves[0]
    other = next(node for node in plan.tree.parents[1:] if not leaf.startswith(f"{node}/"))
    words = ("--pace", "max") if run == "recorded" else ()
    replay = heliarch("replay", folder, "--without", f"{leaf},{other}", *words)
    for agent in (leaf, other):
        started(replay.until_said(f"start {agent}:"))
    endpoint, keys = replay.until_said("endpoint"), replay.until_said("keys")
    with subscriber(endpoint, keys) as heard:
        assert replay.wait() == 0, replay.error_text()
    at = len(f"{plan.run_id}/{plan.plant}/")
    senders = {key[at:].rpartition("/")[0] for key, _ in heard}
    own = {f"{leaf}/impp", f"{leaf}/command", f"{other}/impp"}
    assert not own & {key[at:] for key, _ in heard}, "the replay does not send these"
    assert {"c1", ""} <= senders
    assert "replayed " in replay.output.read_text()


def test_a_replay_waits_in_lockstep_for_an_agent_that_stands_still(
    heliarch: Start, recorded: Path, plan: RunPlan
) -> None:
    leaf = plan.tree.leaves[0]
    replay = heliarch("replay", recorded, "--without", leaf, "--pace", "5")
    words = shlex.split(replay.until_said(f"start {leaf}:"))
    agent = subprocess.Popen(words)
    try:
        replay.until(lambda: "cycle 0" in replay.output.read_text(), "its first cycle")
        agent.send_signal(signal.SIGSTOP)
        replay.until(lambda: f"waits for {leaf}/" in replay.output.read_text(), "it to wait")
        agent.send_signal(signal.SIGCONT)
        assert replay.wait() == 0, replay.error_text()
    finally:
        agent.kill()
        agent.wait()
