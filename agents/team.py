"""Makes the agents of a run from its plan."""

from __future__ import annotations

from typing import Any, TypeAlias

from agents.agent import Agent
from agents.central import CentralController
from agents.direct import DirectController
from agents.family import Family
from agents.plan import RunPlan
from agents.supervisor import Supervisor
from bus_schemas.errors import InputError
from bus_schemas.tree import CENTRAL, ROOT

Controller: TypeAlias = Agent[Any]
"""An agent whose state is its own business."""


def direct_controller(plan: RunPlan, node: str) -> DirectController:
    """Return the direct controller of an inverter."""
    return DirectController(
        node,
        plan.tree.rating_kw(node),
        plan.alpha_min,
        plan.periods,
        plan.scheme,
        plan.actuator,
    )


def supervisor(plan: RunPlan, node: str) -> Supervisor:
    """Return the supervisor of a cluster."""
    return Supervisor(_family(plan, node), plan.periods)


def central_controller(plan: RunPlan) -> CentralController:
    """Return the central controller."""
    return CentralController(_family(plan, ROOT), plan.periods)


def controllers(plan: RunPlan) -> list[Controller]:
    """Return all controllers of a run, the central one first."""
    tree = plan.tree
    return [
        central_controller(plan),
        *(supervisor(plan, node) for node in tree.parents if node != ROOT),
        *(direct_controller(plan, node) for node in tree.leaves),
    ]


def check_node(plan: RunPlan, kind: str, node: str) -> None:
    """Refuse a node that the run does not have, or not as this kind of controller.

    Raises
    ------
    InputError
        With the nodes that are accepted.
    """
    tree = plan.tree
    accepted = {
        "direct": tree.leaves,
        "supervisor": tuple(path for path in tree.parents if path != ROOT),
        "central": (CENTRAL,),
    }[kind]
    if node not in accepted:
        raise InputError(f"--node {node}: no {kind} of this run, accepted: {', '.join(accepted)}")


def _family(plan: RunPlan, node: str) -> Family:
    tree = plan.tree
    children = tree.children(node)
    return Family(
        node,
        children,
        tuple(tree.rating_kw(child) for child in children),
        plan.neighbourhoods_of(node),
        plan.hold_cycles,
        lends=plan.scheme == "predictive" and plan.periods.rests_between(node),
    )
