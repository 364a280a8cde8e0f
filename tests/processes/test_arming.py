"""The barrier before cycle 0, with real processes: nobody is late, and who is missing is named."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from agents.events import AnyEvent, Armed
from agents.plan import RunPlan
from bus_schemas.links import explicit_links
from bus_schemas.signals import IMPP, TELEMETRY
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.preparation import RunOptions, prepare
from launch_scripts.processes import ProcessSpec, processes
from launch_scripts.run_folder import RunFolder
from launch_scripts.scenario import load_scenario
from launch_scripts.supervision import Children, RunFailure
from launch_scripts.tcp_ports import reserved_ports
from recordings.reader import RunReader

pytestmark = pytest.mark.processes

CYCLES = 5
LATE = "c1/inv01"


@contextmanager
def planned(tmp_path: Path) -> Iterator[tuple[RunPlan, RunFolder]]:
    """A run of a few cycles, ready to be started by hand."""
    options = RunOptions(duration=str(CYCLES))
    preparation = prepare(load_scenario("oahu"), options, "arming-test")
    folder = RunFolder(tmp_path / "run")
    with reserved_ports(explicit_links(preparation.plan.tree).listening) as tcp_ports:
        yield folder.fill(preparation, tcp_ports), folder


def specs(plan: RunPlan, folder: RunFolder) -> tuple[list[ProcessSpec], ProcessSpec]:
    """All processes but one, and that one."""
    everybody = processes(plan.tree, folder.plan)
    return (
        [spec for spec in everybody if spec.agent != LATE],
        next(spec for spec in everybody if spec.agent == LATE),
    )


def with_patience(specs: list[ProcessSpec], patience_s: float) -> list[ProcessSpec]:
    """The same processes, with a plant that waits for the others for so long."""
    return [
        replace(spec, command=(*spec.command, "--patience", str(patience_s)))
        if spec.agent == PLANT
        else spec
        for spec in specs
    ]


def missed_by_the_plant(patience_s: float, folder: Path) -> set[str]:
    """Whom the plant names when one of them never comes and it gives up after a time."""
    with planned(folder) as (plan, run):
        others, _ = specs(plan, run)
        with (
            Children(with_patience(others, patience_s), run.logs) as children,
            pytest.raises(RunFailure, match="plant gave up: no sign of life from") as failure,
        ):
            until_finished(children)
    named = re.search(r"no sign of life from ([^;\n]*)", str(failure.value))
    assert named is not None
    return set(named[1].split(", "))


def test_the_plant_does_not_begin_without_everybody_and_says_who_is_missing(
    tmp_path: Path,
) -> None:
    # On a slow machine others are not there yet either: then they have more time to come.
    for patience_s in (3.0, 12.0, 48.0):
        missed = missed_by_the_plant(patience_s, tmp_path / f"{patience_s:g}")
        assert LATE in missed
        if missed == {LATE}:
            return
    pytest.fail(f"the plant misses {missed}")


def test_a_latecomer_is_waited_for_and_takes_part_from_cycle_0(tmp_path: Path) -> None:
    with planned(tmp_path) as (plan, folder):
        others, late = specs(plan, folder)
        with Children(with_patience(others, 600.0), folder.logs) as children:
            heard = until_ready(children)
            assert not any(isinstance(event, Armed) for event in heard)
            with Children([late], folder.logs) as latecomer:
                until_finished(children)
                latecomer.await_exit(list(latecomer), 60.0)
                children.await_exit(children.controllers(), 60.0)
                children[RECORDER].tell("expect 0")
                assert children.await_exit([children[RECORDER]], 60.0) == []
    with RunReader(folder.path) as reader:
        heard_from = [(m.cycle, str(p)) for p, m in reader.messages(IMPP) if p.node == LATE]
        told = [(m.cycle, str(p)) for p, m in reader.messages(TELEMETRY) if p.node == LATE]
    assert heard_from == [(cycle, f"{LATE}/impp") for cycle in range(CYCLES)]
    assert told == [(cycle, f"{LATE}/telemetry") for cycle in range(CYCLES)]


def until_ready(children: Children) -> list[AnyEvent]:
    """Hear the processes until all of them are on the bus."""
    heard: list[AnyEvent] = []
    give_up_at = time.monotonic() + 120.0
    while not all(child.ready for child in children):
        assert time.monotonic() < give_up_at
        heard += [event for _, event in children.events(0.1)]
    return heard


def until_finished(children: Children) -> None:
    """Hear the processes until the plant is through."""
    give_up_at = time.monotonic() + 120.0
    while children[PLANT].finished is None:
        assert time.monotonic() < give_up_at
        children.events(0.1)
