"""The plan of a run: written by the launcher, read by every process."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from plants_by_hand import plan_of

from agents.family import Neighbourhood
from agents.plan import NodeNeighbourhoods, RunPlan, load_plan
from agents.team import check_node
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
    path = tmp_path / "plan.json"
    assert complaint(path) == f"{path}: no such file, accepted is the plan.json of a run"


def test_a_file_that_is_no_json_is_refused(path: Path) -> None:
    path.write_text("# a scenario\n", encoding="utf-8")
    assert complaint(path) == (
        f"{path}: JSON is malformed: invalid character (byte 0), accepted is the plan.json of a run"
    )


def test_a_plan_that_was_cut_off_is_refused(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100])
    assert (
        complaint(path) == f"{path}: Input data was truncated, accepted is the plan.json of a run"
    )


def test_a_plan_that_lacks_a_field_is_refused(path: Path) -> None:
    fields = json.loads(path.read_text(encoding="utf-8"))
    del fields["hold_cycles"]
    path.write_text(json.dumps(fields), encoding="utf-8")
    assert complaint(path) == (
        f"{path}: Object missing required field `hold_cycles`, accepted is the plan.json of a run"
    )


def test_a_plan_with_a_word_for_a_number_is_refused(path: Path) -> None:
    fields = json.loads(path.read_text(encoding="utf-8"))
    fields["cycles"] = "many"
    path.write_text(json.dumps(fields), encoding="utf-8")
    assert complaint(path) == (
        f"{path}: Expected `int`, got `str` - at `$.cycles`, accepted is the plan.json of a run"
    )


def test_a_plan_that_is_not_utf8_is_refused(path: Path) -> None:
    path.write_bytes(PLAN.as_json().replace(b'"oahu"', b'"o\xff"'))
    assert complaint(path) == (
        f"{path}: 'utf-8' codec can't decode byte 0xff in position 1: invalid start byte, "
        "accepted is the plan.json of a run"
    )


def test_a_folder_is_no_plan(tmp_path: Path) -> None:
    assert complaint(tmp_path) == (
        f"{tmp_path}: Is a directory, accepted is the plan.json of a run"
    )


@pytest.mark.parametrize("periods", [(1,), (10, 5, 1)])
def test_a_plan_needs_a_period_for_each_tier_that_has_children(
    path: Path, periods: tuple[int, ...]
) -> None:
    path.write_bytes(msgspec.structs.replace(PLAN, period_cycles=periods).as_json())
    assert complaint(path) == (
        f"{path}: period_cycles has {len(periods)} entries, accepted is one for each of the "
        "2 tiers that have children"
    )


@pytest.mark.parametrize(
    ("kind", "node", "accepted"),
    [
        ("direct", "c1", "c1/a, c1/b, c2/a"),
        ("direct", "c1/z", "c1/a, c1/b, c2/a"),
        ("supervisor", "c1/a", "c1, c2"),
        ("supervisor", "central", "c1, c2"),
        ("central", "c1", "central"),
    ],
)
def test_a_node_that_the_run_does_not_have_is_refused(kind: str, node: str, accepted: str) -> None:
    with pytest.raises(InputError) as caught:
        check_node(PLAN, kind, node)
    assert str(caught.value) == f"--node {node}: no {kind} of this run, accepted: {accepted}"


def test_the_nodes_of_a_run_are_accepted() -> None:
    for kind, node in (("direct", "c2/a"), ("supervisor", "c2"), ("central", "central")):
        check_node(PLAN, kind, node)
