"""The stages of a cycle, their places and deadlines, stated once: the agents agree with them."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plans_by_hand import plan_of

from agents.agent import Agent
from agents.cycle import KINDS, STAGES, USED_SHARE, Deadlines, kind_of, stage_of
from agents.settings import StorageSettings
from agents.team import controllers
from bus_schemas.signals import COMMAND, PRODUCTION, SETPOINT
from bus_schemas.tree import ROOT, ControlTree
from sim_plant.plant import Plant
from sim_plant.profile import Profile

FLAT = ControlTree((("a", 1.0), ("b", 1.0)))
THREE_TIERS = ControlTree((("c1/a", 100.0), ("c1/b", 100.0), ("c2/a", 100.0)))
RAGGED = ControlTree(
    (("a", 1.0), ("c1/b", 1.0), ("z1/c1/d", 1.0), ("z1/y1/x1/e", 1.0)),
    (("battery", 1.0), ("z1/battery", 1.0)),
)
MS = 1_000_000
EXAMPLE = Path(__file__).parents[2] / "examples" / "direct_controller.py"


def team(tree: ControlTree) -> list[Agent[Any]]:
    """All agents of a plant but the recorder."""
    storages = [
        StorageSettings(name=parts[2], cluster=parts[0], rating_kw=kw, capacity_kwh=1.0)
        for path, kw in tree.storages
        for parts in [path.rpartition("/")]
    ]
    plan = plan_of(dict(tree.inverters), storages=tuple(storages))
    count = len(tree.leaves)
    return [Plant(plan, Profile(np.ones((1, count)), np.ones(1))), *controllers(plan)]


STAGES_IN_ORDER = [
    *(("plant", "sense"), ("c1/a", "estimate"), ("c1", "report"), ("central", "solve")),
    *(("c1", "solve"), ("c1/a", "actuate"), ("plant", "apply")),
]
"""Agent and stage, as one comes after the other on the way of a message through three tiers."""


def test_each_agent_goes_through_the_stages_of_its_kind() -> None:
    found = {}
    for agent in team(RAGGED):
        kind = kind_of(agent.name, RAGGED)
        found[kind] = tuple(stage.name for stage in agent.stages(0))
        assert found[kind] == STAGES[kind]
    assert set(found) == set(KINDS) - {"recorder"}
    later = (SETPOINT.of("c1/a"), COMMAND.of("c1/a"), PRODUCTION.of(ROOT))
    assert [stage_of(port, THREE_TIERS) for port in later] == ["solve", "actuate", "apply"]


@pytest.mark.parametrize("tree", [FLAT, THREE_TIERS, RAGGED])
def test_whoever_hears_waits_longer_than_whoever_sends(tree: ControlTree) -> None:
    deadlines = Deadlines(tree, 1_000 * MS)
    for agent in team(tree):
        for stage in agent.stages(0):
            own_ns = deadlines.deadline_ns(agent.name, stage.name)
            for port in stage.awaits:
                sent_in = stage_of(port, tree)
                assert deadlines.deadline_ns(port.publisher, sent_in) < own_ns, f"{port}"


def test_the_first_place_has_a_part_of_the_cycle_for_each_tier_and_one_more() -> None:
    deadlines = Deadlines(THREE_TIERS, 1_200 * MS)
    found = [deadlines.deadline_ns(*place) for place in STAGES_IN_ORDER]
    assert found == [0, *(135 * MS * parts for parts in range(3, 9))]
    slices = [deadlines.slice_ns(*place) for place in STAGES_IN_ORDER]
    assert slices == [135 * MS, 405 * MS, *[135 * MS] * 5]
    assert found[-1] == USED_SHARE * 1_200 * MS


@pytest.mark.parametrize("tree", [FLAT, THREE_TIERS, RAGGED])
def test_the_example_works_out_the_same_deadlines(
    tree: ControlTree, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(EXAMPLE.parent)
    plan = plan_of(dict(tree.inverters), cycle_wall_ns=1_000 * MS)
    deadlines_s = runpy.run_path(str(EXAMPLE))["deadlines_s"]
    for leaf in tree.leaves:
        for stage, found_s in deadlines_s(json.loads(plan.as_json()), leaf).items():
            assert found_s == pytest.approx(plan.deadlines.deadline_ns(leaf, stage) / 1e9)
