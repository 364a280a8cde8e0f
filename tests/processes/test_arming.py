"""The barrier before cycle 0, with real processes: nobody is late, and who is missing is named."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from running import assert_none_left, small_plant

from agents.events import Armed, Event
from agents.plan import RunPlan
from bus_schemas.links import explicit_links
from bus_schemas.signals import IMPP, TELEMETRY
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.launcher.fork_requests import Start
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.supervision import Children, ForkServerProcess, RunFailure
from launch_scripts.launcher.tcp_ports import reserved_ports
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from recordings.read.reader import RunReader

pytestmark = pytest.mark.processes

CYCLES = 5
LATE = "c1/inv01"
LONG_S = 600.0


@contextmanager
def planned(tmp_path: Path) -> Iterator[tuple[RunPlan, RunFolder]]:
    """A run of a few cycles, ready to be started by hand."""
    scenario = load_scenario(small_plant(tmp_path / "plant"))
    preparation = prepare(scenario, RunOptions(duration=str(CYCLES)), "arming-test")
    folder = RunFolder(tmp_path / "run")
    with reserved_ports(explicit_links(preparation.plan.tree).listening) as tcp_ports:
        yield folder.fill(preparation, tcp_ports), folder


@contextmanager
def started(
    plan: RunPlan, folder: RunFolder, agents: tuple[str, ...], patience_s: float
) -> Iterator[Children]:
    """Some agents of a run, each as a process; the plant waits for the others for so long."""
    server = ForkServerProcess()
    with Children(server, plan, agents, folder.logs) as children:
        server.ask(Start(str(folder.plan), agents, str(folder.logs), patience_s))
        yield children


def all_but_one(plan: RunPlan) -> tuple[str, ...]:
    return tuple(agent for agent in plan.tree.agents() if agent != LATE)


def hear_until(children: Children, condition: str) -> list[Event]:
    """Hear the processes until they are all `ready`, or the plant is `finished`."""
    heard: list[Event] = []
    give_up_at = time.monotonic() + 120.0
    while not (
        all(child.ready for child in children)
        if condition == "ready"
        else children[PLANT].finished is not None
    ):
        assert time.monotonic() < give_up_at
        heard += [event for _, event in children.events(0.1)]
    return heard


def missed_by_the_plant(patience_s: float, folder: Path) -> set[str]:
    """Whom the plant names when one of them never comes and it gives up after a time."""
    with (
        planned(folder) as (plan, run),
        started(plan, run, all_but_one(plan), patience_s) as children,
        pytest.raises(RunFailure, match="plant gave up: no sign of life from") as failure,
    ):
        hear_until(children, "finished")
    assert_none_left(run.path)
    named = re.search(r"no sign of life from ([^;\n]*)", str(failure.value))
    assert named is not None
    return set(named[1].split(", "))


def test_the_plant_does_not_begin_without_everybody_and_says_who_is_missing(
    tmp_path: Path,
) -> None:
    # On a slow machine others are not there yet either: then they have more time to come.
    for patience_s in (2.0, 8.0, 32.0):
        folder = tmp_path / f"{patience_s:g}"
        folder.mkdir()
        missed = missed_by_the_plant(patience_s, folder)
        assert LATE in missed
        if missed == {LATE}:
            return
    pytest.fail(f"the plant misses {missed}")


def test_a_latecomer_is_waited_for_and_takes_part_from_cycle_0(tmp_path: Path) -> None:
    with (
        planned(tmp_path) as (plan, folder),
        started(plan, folder, all_but_one(plan), LONG_S) as children,
    ):
        heard = hear_until(children, "ready")
        assert not any(isinstance(event, Armed) for event in heard)
        with started(plan, folder, (LATE,), LONG_S) as latecomer:
            hear_until(children, "finished")
            latecomer.await_exit(list(latecomer), 60.0)
            children.await_exit(children.controllers(), 60.0)
            children.end_recorder(0)
            assert children.await_exit([children[RECORDER]], 60.0) == []
    with RunReader(folder.path) as reader:
        sent = [m.cycle for port, m in reader.messages(IMPP) if port.node == LATE]
        heard_of = [m.cycle for port, m in reader.messages(TELEMETRY) if port.node == LATE]
    assert sent == heard_of == list(range(CYCLES))
