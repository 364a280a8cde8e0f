"""What a page shows of a recording: also while that is written, and of what is missing in it."""

from __future__ import annotations

from pathlib import Path

import pytest
import recorded_runs
from msgspec.structs import replace
from plans_by_hand import with_changes
from recorded_runs import cloudy_profile, published, record
from recordings_by_hand import (
    PLAN,
    whole_run,
    write_run,
)
from served import growing_run

from agents.settings import StorageSettings
from bus_schemas.bus import Delivery
from bus_schemas.messages import Notice, Production, Telemetry
from bus_schemas.signals import NOTICE, PRODUCTION, TELEMETRY
from bus_schemas.tree import ROOT
from live_page.follower import RunFollower
from live_page.plant_state import PlantState
from results.report.run_report import write_run_report


def followed(path: Path) -> RunFollower:
    follower = RunFollower(path)
    while not follower.advance(1.0):
        pass
    return follower


def kinds(follower: RunFollower) -> list[tuple[str, int, str]]:
    return [(event.kind, event.cycle, event.agent) for event in follower.events]


def number(node: str) -> int:
    return PLAN.tree.nodes.index(node)


def test_a_recording_is_followed_while_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with growing_run(path) as add:
        add(0)
        follower = followed(path)
        assert (follower.cycles, follower.state) == (1, "running")
        for cycle in range(1, 5):
            add(cycle)
            follower.advance(1.0)
            assert follower.cycles == cycle + 1
    follower.advance(1.0)
    assert follower.state == "unfinished"
    assert follower.powers(range(5), 100)["delivered"] == [239.0] * 5


def test_a_frame_has_the_powers_the_help_and_the_shares(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_run(path, whole_run(20))
    state = PlantState(followed(path))
    frame = state.frame(7)
    nodes = frame["nodes"]
    assert nodes["impp"][number("c1/a")] == 40.0
    assert nodes["share"][number("c1/a")] == 60.0
    assert nodes["help"][number("c1/b")] == 20.0
    assert nodes["power"][number("c1")] == 120.0
    assert frame["help"] == [(number("c1/b"), number("c1/a"), 20.0)]
    assert set(frame["agents"]["kind"]) == {"fine"}
    # The central controller acts every other cycle: its newest setpoint holds.
    assert nodes["setpoint"][number("c1")] == 120.0


def test_a_storage_shows_its_state_and_what_it_gives_and_takes(tmp_path: Path) -> None:
    battery = StorageSettings(name="battery", cluster="c1", rating_kw=80.0, capacity_kwh=1.0)
    plan = recorded_runs.plan_of(cycles=12, storages=(battery,))
    profile = cloudy_profile(plan)
    messages = published(plan, profile)
    made = [one for _, one in messages if isinstance(one, Production) and one.cycle >= 0]
    run = record(tmp_path / "run", plan, messages, profile)
    state, nodes = PlantState(followed(run / "run.mcap")), plan.tree.nodes
    taken_kw = 0.0
    for cycle, production in enumerate(made):
        shown = state.frame(cycle)["nodes"]
        at, parent = nodes.index("c1/battery"), nodes.index("c1")
        (power_kw,), (energy_kwh,) = (
            production.storage_power_kw or (),
            production.storage_energy_kwh or (),
        )
        assert shown["power"][at] == pytest.approx(power_kw, abs=0.01)
        assert shown["stored"][at] == pytest.approx(100.0 * energy_kwh, abs=0.01)
        assert (shown["share"][at], shown["stored"][parent]) == (0.0, None)
        inverters_kw = sum(production.inverter_power_kw[i] for i in plan.tree.leaves_below("c1"))
        assert shown["power"][parent] == pytest.approx(inverters_kw + power_kw, abs=0.02)
        taken_kw = max(taken_kw, abs(power_kw))
    assert taken_kw > 10.0
    page = write_run_report(run).read_text(encoding="utf-8")
    assert 'id="storage"' in page


def test_an_impp_is_only_an_upper_bound_where_a_limit_hides_the_maximum(tmp_path: Path) -> None:
    limited = {
        "c1/a": {"power_kw": 49.9, "limit_kw": 50.0},
        "c1/b": {"power_kw": 30.0, "limit_kw": 50.0},
        "c2/c": {"power_kw": 50.0, "limit_kw": 50.0, "available_kw": 70.0},
    }

    def read(delivery: Delivery) -> Delivery:
        port, message = delivery
        if isinstance(message, Telemetry):
            message = replace(message, **limited.get(port.node, {}))
        return port, message

    write_run(tmp_path / "run.mcap", map(read, whole_run(20)))
    state = PlantState(followed(tmp_path / "run.mcap"))
    nodes = state.frame(7)["nodes"]
    bounds = {node: nodes["bound"][number(node)] for node in PLAN.tree.nodes}
    assert {node for node, bound in bounds.items() if bound is not None} == {ROOT, "c1", "c1/a"}
    assert bounds["c1/a"] == nodes["impp"][number("c1/a")]
    assert state.powers("c1/a", 7)["bound"] == bounds["c1/a"]


def test_missing_messages_are_shown_as_missing(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"

    def is_kept(delivery: Delivery) -> bool:
        port, message = delivery
        silent = port.publisher == "c2/c" and 5 <= message.cycle < 12
        return not silent and not (isinstance(message, Production) and message.cycle == 8)

    write_run(path, whole_run(20), is_kept=is_kept)
    follower = followed(path)
    powers = follower.powers(range(7, 10), 100)
    assert powers["delivered"][1] != powers["delivered"][1]  # NaN
    assert powers["dispatch"][1] == 240.0
    state = PlantState(follower)
    frame = state.frame(8)
    assert frame["nodes"]["impp"][number("c2/c")] is None
    assert frame["nodes"]["power"] == [None] * len(PLAN.tree.nodes)
    agents = frame["agents"]
    place = 1 + number("c2/c")
    assert (agents["cycles"][place], agents["kind"][place]) == (4, "cut off")
    assert state.powers("c2/c", 8)["impp"] is None
    assert ("cut off", 5, "c2/c") in kinds(follower)


def test_a_real_inverter_that_is_gone_for_a_while_or_for_good_is_named(tmp_path: Path) -> None:
    path, telemetry = tmp_path / "run.mcap", TELEMETRY.of("c2/c")
    plan = with_changes(PLAN, devices=(("c2/c", "modbus://10.0.0.7:502/1"),))
    gone = {*range(5, 12), *range(85, 100)}
    run = [pair for pair in whole_run(100) if pair[0] is not telemetry or pair[1].cycle not in gone]
    write_run(path, run, plan=plan)
    follower = followed(path)
    assert [event for event in kinds(follower) if event[0] != "run"] == [
        ("absent", 5, "device c2/c"),
        ("back", 12, "device c2/c"),
        ("absent", 85, "device c2/c"),
    ]
    assert {event.count for event in follower.events} == {1}
    state = PlantState(follower)
    assert [state.frame(cycle)["unread"] for cycle in (4, 5)] == [[], [number("c2/c")]]


def test_repeated_notices_are_one_event_with_a_count(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    notices = [
        (NOTICE.of("c1"), Notice(cycle, 0, "c1", (), text="mended", count=cycle + 1))
        for cycle in range(4)
    ]
    write_run(path, [*whole_run(5), *notices])
    (event,) = [event for event in followed(path).events if event.kind == "notice"]
    assert (event.text, event.cycle, event.count) == ("mended", 0, 4)


def test_a_long_run_is_thinned_out_without_losing_a_dip(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    deliveries = [d for d in whole_run(900) if d[0].signal.name in {"dispatch", "production"}]
    for port, message in deliveries:
        if port.signal is PRODUCTION and message.cycle == 444:
            assert isinstance(message, Production)
            message.inverter_power_kw = (3.0, 0.0, 0.0, 0.0)
    write_run(path, deliveries)
    powers = followed(path).powers(range(900), 60)
    assert len(powers["cycle"]) < 200
    assert min(powers["delivered"]) == 3.0


def test_a_setpoint_of_a_slow_turn_is_shown_until_the_next_one(tmp_path: Path) -> None:
    plan = with_changes(PLAN, period_cycles=(60, 1))
    slow = {"c1/setpoint", "c2/setpoint"}
    run = [one for one in whole_run(70) if one[1].cycle % 60 == 0 or str(one[0]) not in slow]
    write_run(tmp_path / "run.mcap", run, plan=plan, messages_per_chunk=35)
    state = PlantState(followed(tmp_path / "run.mcap"))
    shown = [state.frame(cycle)["nodes"]["setpoint"][number("c1")] for cycle in range(70)]
    assert shown == [120.0] * 70
