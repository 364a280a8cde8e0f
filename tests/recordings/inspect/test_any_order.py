"""Events, figures and health are the same in whatever order the messages were recorded."""

from __future__ import annotations

import random
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from command_line import done
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_runs import run_with
from msgspec.structs import replace
from recordings_by_hand import write_messages
from running import REPOSITORY, small_plant

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from live_page.follower import RunFollower
from recordings.inspect.agent_states import states_of
from recordings.inspect.overview import read_overview
from recordings.read.reader import RunReader
from recordings.read.series import plant_series_of
from results.figures import run_figures
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario

CYCLES = 60
FAULTS = (
    "kill=c1/inv01,at=10s",
    "freeze=c2,at=20s..28s",
    "partition=c1|central,at=40s..50s",
    "loss=4%,at=50s..60s",
)


@dataclass(repr=False)
class Recorded:
    plan: RunPlan
    messages: list[Delivery]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """All messages of a run with a kill, a freeze, a cut and lost messages."""
    plant = small_plant(tmp_path_factory.mktemp("plant"))
    prepared = prepare(load_scenario(plant), RunOptions(duration=str(CYCLES)), "any-order")
    run, sent = run_with(prepared, FAULTS)
    return Recorded(run.plan, sent.messages)


def shown(path: Path) -> dict[str, Any]:
    """What the page, `inspect` and the figures say of a recording."""
    follower = RunFollower(path)
    while not follower.advance(1.0):
        pass
    with RunReader(path) as run:
        overview = read_overview(run)
        figures = run_figures(plant_series_of(run))
        states = states_of(run)
    return {
        "health": replace(overview, path="", wall_s=0.0, signals=(), metadata={}),
        "signals": [(one.signal, one.messages, one.missing_cycles) for one in overview.signals],
        "figures": figures,
        "states": [states.at(agent, 45) for agent in states.agents],
        "events": sorted(
            (one.kind, one.cycle, one.agent, one.text, one.count) for one in follower.events
        ),
    }


@pytest.fixture(scope="module")
def in_order(recorded: Recorded, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    path = tmp_path_factory.mktemp("in-order") / "run.mcap"
    write_messages(path, recorded.messages, plan=recorded.plan, driver="launch")
    return shown(path)


def test_the_faults_of_the_run_are_shown(in_order: dict[str, Any]) -> None:
    found = {(span.agent, span.kind, span.cause) for span in in_order["health"].states}
    assert {("c1/inv01", "absent", "killed"), ("c2", "absent", "frozen")} <= found
    assert ("c1", "cut off", "") in found


@given(
    seed=st.integers(0, 2**32),
    queue=st.sampled_from([0, 5, 60, 300]),
    late_links=st.integers(0, 6),
    delay=st.sampled_from([30, 300, 600]),
)
@settings(max_examples=12)
def test_any_order_of_arrival_shows_the_same(
    recorded: Recorded,
    in_order: dict[str, Any],
    tmp_path_factory: pytest.TempPathFactory,
    seed: int,
    queue: int,
    late_links: int,
    delay: int,
) -> None:
    """Messages are shuffled within the recorder's queue, and whole links come up to 30 s later."""
    draw = random.Random(seed)
    links = sorted({port for port, _ in recorded.messages}, key=str)
    late = {port: draw.uniform(0, delay) for port in draw.sample(links, late_links)}
    arrives = {
        id(message): number + draw.uniform(0, queue) + late.get(port, 0.0)
        for number, (port, message) in enumerate(recorded.messages)
    }
    shuffled = sorted(recorded.messages, key=lambda pair: arrives[id(pair[1])])
    path = tmp_path_factory.mktemp("shuffled") / "run.mcap"
    write_messages(path, shuffled, plan=recorded.plan, driver="launch")
    found = shown(path)
    for what, expected in in_order.items():
        assert found[what] == expected, what


def test_a_late_recorder_makes_no_agent_absent_in_a_healthy_run() -> None:
    path = REPOSITORY.parent / "shared" / "cases" / "out-of-order"
    if not path.is_dir():
        pytest.skip(f"the recording of a late recorder is absent: no folder {path}")
    follower, seen = RunFollower(path / "run.mcap"), set()
    while not follower.advance(0.0):
        seen |= {event.kind for event in follower.events}
    assert seen | {event.kind for event in follower.events} == {"run"}
    with RunReader(path) as run:
        assert read_overview(run).states == ()
        states = states_of(run)
        for cycle in (0, 300, run.last_cycle):
            assert {states.at(agent, cycle).level for agent in states.agents} == {0}


@pytest.mark.processes
def test_page_inspect_and_report_agree_on_real_kills_freezes_and_cuts(
    plant: str, tmp_path: Path
) -> None:
    faults = (
        "kill=c1/inv01,at=8s",
        "freeze=c2/inv03,at=12s..40s",
        "partition=c1|central,at=20s..30s",
    )
    words = (word for fault in faults for word in ("--fault", fault))
    run = tmp_path / "run"
    done("launch", plant, "--duration", "45", "--pace", "3", *words, "--out", run)
    with RunReader(run) as reader:
        spans, states = read_overview(reader).states, states_of(reader)
        last = reader.last_cycle
    follower = RunFollower(run / "run.mcap")
    while not follower.advance(1.0):
        pass
    events = {(one.kind, one.cycle, one.agent) for one in follower.events}
    assert {(one.kind, one.first_cycle, one.agent) for one in spans if one.cycles} == {
        event for event in events if event[0] in {"absent", "cut off", "given up"}
    }
    causes = {(span.agent, span.cause) for span in spans}
    assert {("c1/inv01", "killed"), ("c2/inv03", "frozen"), ("c1", "")} <= causes
    for cycle in range(last + 1):
        for agent in states.agents:
            assert states.at(agent, cycle) == follower.states.at(agent, cycle)
