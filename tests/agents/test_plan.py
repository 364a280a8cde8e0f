"""The plan of a run: written by the launcher, read by every process."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from complaints import complaint_of
from plans_by_hand import plan_of

from agents.plan_file import check_plan, load_plan

PLAN = plan_of({"c1/a": 470.5, "c1/b": 1 / 3, "c2/a": 1e6}, cycles=3600, period_cycles=(10, 1))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "plan.json"
    path.write_bytes(PLAN.as_json())
    return path


def test_a_plan_that_is_not_there_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "plan.json", tmp_path):
        assert complaint_of(load_plan, path).startswith(f"{path}: ")


def with_field(part: str, name: str, value: object) -> Callable[[bytes], bytes]:
    def change(data: bytes) -> bytes:
        plan = json.loads(data)
        return msgspec.json.encode(plan | {part: plan[part] | {name: value}})

    return change


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda data: b"# a scenario\n", "JSON"),
        (lambda data: data[:100], "truncated"),
        (lambda data: data.replace(b'"oahu"', b'"o\xff"'), "utf-8"),
        (lambda data: data.replace(b'"hold_cycles"', b'"hold"'), "hold"),
        (lambda data: b'{"protocol": 1, "cycles": 60}', "protocol"),
        # `node` names its folder after the plant.
        (lambda data: data.replace(b'"oahu"', b'"../../elsewhere/x"'), "plant"),
        (lambda data: data.replace(b'"by-hand"', b'"/tmp/x"'), "run_id"),
        (with_field("timing", "cycles", "many"), "cycles"),
        (with_field("control", "period_cycles", [1]), "period_cycles"),
        (with_field("control", "period_cycles", [10, 5, 1]), "period_cycles"),
        (with_field("control", "period_cycles", [10, 0]), "period_cycles[1]"),
    ],
)
def test_a_plan_that_cannot_be_used_is_refused_and_says_where(
    path: Path, change: Callable[[bytes], bytes], named: str
) -> None:
    path.write_bytes(change(path.read_bytes()))
    found = complaint_of(load_plan, path)
    assert found.startswith(f"{path}: ")
    assert named in found


TALL = dict.fromkeys(("z1/c1/a", "z1/c1/b", "z1/c2/c", "z2/c3/d"), 100.0)


def test_an_agent_is_in_the_process_of_the_nearest_group_above_it_on_its_host() -> None:
    away = {"z1/c2": "10.0.0.2", "z1/c2/c": "10.0.0.2", "z2/c3/d": "10.0.0.2"}
    plan = plan_of(
        TALL,
        groups=("z1", "z1/c1", "z2"),
        external=("z1/c1/b",),
        addresses=away,
    )
    assert plan.processes == (
        *("recorder", "plant", "central", "z1", "z2", "z1/c1", "z1/c2"),
        *("z1/c1/b", "z1/c2/c", "z2/c3/d"),
    )
    assert plan.wiring.members["z1/c1"] == ["z1/c1", "z1/c1/a"]
    assert plan.wiring.members["z2"] == ["z2", "z2/c3"]


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"groups": ("z9",)}, "processes: expected any of central, z1"),
    ],
)
def test_groups_that_cannot_be_are_refused(changes: dict[str, object], complaint: str) -> None:
    assert complaint_of(check_plan, plan_of(TALL, **changes)).startswith(complaint)
