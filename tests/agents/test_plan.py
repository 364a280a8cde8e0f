"""The plan of a run: written by the launcher, read by every process."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from plans_by_hand import plan_of

from agents.__main__ import main
from agents.plan import Neighbourhood, NodeNeighbourhoods, RunPlan, load_plan
from bus_schemas.errors import InputError

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


def complaint(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_plan(path)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_what_is_written_is_read_back_to_the_last_bit(path: Path) -> None:
    found = load_plan(path)
    assert found == PLAN
    assert found.tree == PLAN.tree
    assert found.inverters[1] == ("c1/b", 1 / 3)


def test_a_plan_is_plain_json(path: Path) -> None:
    found = json.loads(path.read_text(encoding="utf-8"))
    assert set(found) == set(RunPlan.__struct_fields__)
    assert found["tcp_ports"] == {"recorder": 40001, "c1": 40002}


def test_simulated_time_counts_from_the_first_cycle() -> None:
    assert PLAN.sim_time_ns(0) == 1_270_159_200_000_000_000
    assert PLAN.sim_time_ns(61) == 1_270_159_261_000_000_000
    assert PLAN.sim_time_ns(-1) == 1_270_159_199_000_000_000


def test_a_cycle_without_wall_time_is_lockstep() -> None:
    assert not PLAN.lockstep
    assert msgspec.structs.replace(PLAN, cycle_wall_ns=0).lockstep


def test_a_parent_without_history_has_no_neighbourhoods() -> None:
    assert PLAN.neighbourhoods_of("c1") == HOURS
    assert PLAN.neighbourhoods_of("c2") == ()


def test_a_plan_that_is_not_there_is_refused(tmp_path: Path) -> None:
    assert complaint(tmp_path / "plan.json").startswith(f"{tmp_path / 'plan.json'}: ")
    assert complaint(tmp_path).startswith(f"{tmp_path}: ")


def without(name: str) -> Callable[[bytes], bytes]:
    """Leave a field out."""
    return lambda data: msgspec.json.encode(
        {key: value for key, value in json.loads(data).items() if key != name}
    )


def with_field(name: str, value: object) -> Callable[[bytes], bytes]:
    """Give a field another value."""
    return lambda data: msgspec.json.encode(json.loads(data) | {name: value})


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda data: b"# a scenario\n", "JSON"),
        (lambda data: data[:100], "truncated"),
        (lambda data: data.replace(b'"oahu"', b'"o\xff"'), "utf-8"),
        (without("hold_cycles"), "hold_cycles"),
        (with_field("cycles", "many"), "cycles"),
        (with_field("period_cycles", [1]), "period_cycles"),
        (with_field("period_cycles", [10, 5, 1]), "period_cycles"),
        (with_field("tier_deadlines_ns", [1, 2]), "tier_deadlines_ns"),
    ],
)
def test_a_plan_that_cannot_be_used_is_refused_and_says_where(
    path: Path, change: Callable[[bytes], bytes], named: str
) -> None:
    path.write_bytes(change(path.read_bytes()))
    found = complaint(path)
    assert found.startswith(f"{path}: ")
    assert named in found


@pytest.mark.parametrize("node", ["c1/z", "plant", "recorder", "c9", ""])
def test_an_agent_started_by_hand_must_be_a_controller_of_the_run(
    path: Path, node: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["agents", node, "--plan", str(path)])
    assert main() == 2
    assert node in capsys.readouterr().err
