"""The plan of a run: written by the launcher, read by every process."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from complaints import complaint_of
from plans_by_hand import plan_of

from agents.plan import Neighbourhood, NodeNeighbourhoods, load_plan
from launch_scripts.launcher.process import main

HOURS = (
    Neighbourhood(0, ((1.0, 0.1), (0.1, 1.0))),
    Neighbourhood(3_600_000_000_000, ((1.0, -1 / 3), (-1 / 3, 1.0))),
)
PLAN = msgspec.structs.replace(
    plan_of(
        {"c1/a": 470.5, "c1/b": 1 / 3, "c2/a": 1e6},
        cycles=3600,
        period_cycles=(10, 1),
        neighbourhoods=(NodeNeighbourhoods("c1", HOURS),),
    ),
    start_time_ns=1_270_159_200_000_000_000,
    cycle_wall_ns=16_666_667,
    tcp_ports={"recorder": 40001, "c1": 40002},
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "plan.json"
    path.write_bytes(PLAN.as_json())
    return path


def test_what_is_written_is_read_back_to_the_last_bit(path: Path) -> None:
    found = load_plan(path)
    assert found == PLAN
    assert found.tree == PLAN.tree
    assert found.inverters[1] == ("c1/b", 1 / 3)


def test_a_plan_that_is_not_there_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "plan.json", tmp_path):
        assert complaint_of(load_plan, path).startswith(f"{path}: ")


def with_field(name: str, value: object) -> Callable[[bytes], bytes]:
    return lambda data: msgspec.json.encode(json.loads(data) | {name: value})


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda data: b"# a scenario\n", "JSON"),
        (lambda data: data[:100], "truncated"),
        (lambda data: data.replace(b'"oahu"', b'"o\xff"'), "utf-8"),
        (lambda data: data.replace(b'"hold_cycles"', b'"hold"'), "hold"),
        (with_field("cycles", "many"), "cycles"),
        (with_field("period_cycles", [1]), "period_cycles"),
        (with_field("period_cycles", [10, 5, 1]), "period_cycles"),
        (with_field("period_cycles", [10, 0]), "period_cycles[1]"),
        (with_field("tier_deadlines_ns", [1, 2]), "tier_deadlines_ns"),
    ],
)
def test_a_plan_that_cannot_be_used_is_refused_and_says_where(
    path: Path, change: Callable[[bytes], bytes], named: str
) -> None:
    path.write_bytes(change(path.read_bytes()))
    found = complaint_of(load_plan, path)
    assert found.startswith(f"{path}: ")
    assert named in found


@pytest.mark.parametrize("node", ["c1/z", "c9", ""])
def test_a_process_started_by_hand_must_be_one_of_the_run(
    path: Path, node: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["process", node, "--plan", str(path)])
    assert main() == 2
    assert node in capsys.readouterr().err
