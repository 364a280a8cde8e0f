"""The barrier before cycle 0, with real processes: it names the agents that are missing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from running import assert_none_left, small_plant

from bus_schemas.tree import PLANT
from launch_scripts.launcher.fork_requests import Start
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.supervision import Children, ForkServerProcess, RunFailure
from launch_scripts.launcher.tcp_ports import reserved_ports
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario

pytestmark = pytest.mark.processes

LATE = "c1/inv01"


def see_through(children: Children) -> None:
    while children[PLANT].finished is None:
        children.events(0.1)


def missed_by_the_plant(patience_s: float, folder: Path) -> set[str]:
    """Whom the plant names when one of them never comes and it gives up after a time."""
    preparation = prepare(load_scenario(small_plant(folder)), RunOptions(duration="5"), "arming")
    run, server = RunFolder(folder / "run"), ForkServerProcess()
    with reserved_ports(preparation.plan.links.listening) as tcp_ports:
        plan = run.fill(preparation, tcp_ports)
        agents = tuple(agent for agent in plan.tree.agents() if agent != LATE)
        with Children(server, plan, agents, run.logs) as children:
            server.ask(Start(str(run.plan), agents, str(run.logs), patience_s))
            with pytest.raises(RunFailure, match="plant gave up: no sign of life from") as failure:
                see_through(children)
    assert_none_left(run.path)
    named = re.search(r"no sign of life from ([^;\n]*)", str(failure.value))
    assert named is not None
    return set(named[1].split(", "))


def test_the_plant_does_not_begin_without_everybody_and_says_who_is_missing(
    tmp_path: Path,
) -> None:
    # On a slow machine others are not there yet either: then they have more time to come.
    for patience_s in (2.0, 8.0, 32.0):
        missed = missed_by_the_plant(patience_s, tmp_path / f"{patience_s:g}")
        assert LATE in missed
        if missed == {LATE}:
            return
    pytest.fail(f"the plant misses {missed}")
