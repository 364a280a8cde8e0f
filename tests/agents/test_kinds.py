"""Kinds of processes and their stages are told in one place: it agrees with the agents."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plants_by_hand import plan_of

from agents.agent import Agent
from agents.deadlines import stage_place
from agents.kinds import KINDS, STAGES, Kind, kind_of
from agents.team import central_controller, controllers, direct_controller
from bus_schemas.tree import ControlTree
from sim_plant.plant import Plant
from sim_plant.profile import Profile

PLAN = plan_of({"a": 1.0, "c1/b": 1.0, "z1/c1/d": 1.0}, cycles=1)


@pytest.mark.parametrize(
    ("agent", "kind"),
    [
        ("recorder", "recorder"),
        ("plant", "plant"),
        ("central", "central"),
        ("z1", "supervisor"),
        ("z1/c1", "supervisor"),
        ("a", "direct"),
        ("c1/b", "direct"),
    ],
)
def test_the_kind_of_an_agent_follows_from_the_tree(agent: str, kind: Kind) -> None:
    assert kind_of(agent, PLAN.tree) == kind
    assert kind in KINDS


def test_each_agent_goes_through_the_stages_of_its_kind() -> None:
    tree = ControlTree((("a", 1.0),))
    profile = Profile(mpp_kw=np.array([[1.0]]), commitment_kw=np.array([1.0]))
    team: list[Agent[Any]] = [Plant(tree, profile), *controllers(PLAN)]
    kinds = set()
    for agent in team:
        kind = kind_of(agent.name, PLAN.tree)
        kinds.add(kind)
        assert tuple(stage.name for stage in agent.stages(0)) == STAGES[kind]
    assert kinds == set(STAGES) == set(KINDS) - {"recorder"}


def test_the_stages_of_a_kind_follow_one_another() -> None:
    agents = ("plant", central_controller(PLAN).name, "z1", direct_controller(PLAN, "a").name)
    for agent in agents:
        stages = STAGES[kind_of(agent, PLAN.tree)]
        places = [stage_place(agent, stage, PLAN.tree) for stage in stages]
        assert places == sorted(set(places))
