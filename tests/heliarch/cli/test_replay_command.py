"""`heliarch replay` as a user types it, where it needs no other process."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest
from command_line import heliarch, refusal
from plans_by_hand import with_changes
from replayed_runs import CYCLE_NS, PLAN, run_in_memory, write

SAID = run_in_memory()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of 40 cycles."""
    return write(tmp_path_factory.mktemp("replay") / "run", SAID)


@pytest.mark.parametrize(("cycle_wall_ns", "clock"), [(0, "sim"), (CYCLE_NS, "wall")])
def test_a_run_is_replayed_by_its_own_clock(cycle_wall_ns: int, clock: str, tmp_path: Path) -> None:
    plan = with_changes(PLAN, cycle_wall_ns=cycle_wall_ns)
    folder = write(tmp_path / "run", SAID, plan)
    path = tmp_path / "figures.json"
    words = ("--pace", "20", "--from", "12:00:10", "--to", "12:00:17", "--json", path)
    result = heliarch("replay", folder, *words)
    assert result.exit_code == 0, result.output
    for text in ("endpoint tcp/127.0.0.1:", "keys recorded-1/field/**", "12:00:16 cycle 16 of"):
        assert text in result.stdout
    figures = json.loads(path.read_bytes())
    wanted = sum(10 <= entry.message.cycle < 17 for entry in SAID)
    assert (figures["messages"], figures["cycles"]) == (wanted, 7)
    assert figures["latest_us"] >= 0.0
    # In simulated time a cycle takes its second, here a twentieth of it.
    assert (figures["wall_s"] >= 6 / 20) is (clock == "sim")


def test_some_nodes_and_signals_may_be_replayed_alone_as_fast_as_possible(recorded: Path) -> None:
    words = ("--nodes", "c1/*", "--signals", "impp,setpoint", "--pace", "max", "--json", "-")
    result = heliarch("replay", recorded, *words)
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    wanted = [
        entry
        for entry in SAID
        if entry.port.node.startswith("c1") and entry.port.signal.name in {"impp", "setpoint"}
    ]
    assert (figures["messages"], figures["latest_us"]) == (len(wanted), None)
    assert wanted
    assert "endpoint" in result.stderr


def test_an_address_that_is_taken_is_refused(recorded: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        assert endpoint in refusal("replay", recorded, "--listen", endpoint)


def test_only_controllers_can_be_left_out_and_at_their_own_pace(tmp_path: Path) -> None:
    folder = write(tmp_path / "run", SAID)
    for words, named in (
        (("--without", "c9"), "--without"),
        (("--without", "c1", "--from", "3s"), "--from"),
        (("--without", "c1", "--nodes", "c2"), "--nodes"),
    ):
        assert named in refusal("replay", folder, *words)
    real_time = write(tmp_path / "real", SAID, with_changes(PLAN, cycle_wall_ns=CYCLE_NS))
    assert "--pace" in refusal("replay", real_time, "--without", "c1", "--pace", "2")
