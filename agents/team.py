"""Makes the controllers of a run from its plan."""

from __future__ import annotations

from typing import Any, TypeAlias

from agents.agent import Agent, Stage
from agents.cycle import kind_of
from agents.direct import DirectController
from agents.feedback import Feedback
from agents.parent import CentralController, Supervisor
from agents.plan import RunPlan
from agents.storage import StorageController
from bus_schemas.signals import COMMAND, MEMORY
from bus_schemas.tree import CENTRAL, PLANT, agent_name

Controller: TypeAlias = Agent[Any]
"""An agent; only the agent itself knows the type of its state."""


def controller(plan: RunPlan, name: str) -> Controller:
    """Return the controller of a name: `central`, or the path of a cluster or an inverter."""
    tree, control = plan.tree, plan.control
    if name == CENTRAL:
        feedback = Feedback(plan.correction_law(), plan.grid_law)
        return CentralController(tree, control, feedback, plan.offer_law, plan.pursuit)
    if name in tree.meters:
        feedback = Feedback(plan.correction_law(name), plan.grid_laws[name])
        return Supervisor(name, tree, control, feedback)
    if kind_of(name, tree) == "supervisor":
        return Supervisor(name, tree, control)
    if tree.is_storage(name):
        return StorageController(name, plan.storage_laws[name], control)
    return direct_controller(plan, name)


def direct_controller(
    plan: RunPlan, name: str, kind: type[DirectController] = DirectController
) -> DirectController:
    ratings_kw = plan.tree.rating_kw(name), plan.tree.sharing_kw(name)
    return kind(name, *ratings_kw, plan.control, plan.timing.cycle_s)


def controllers(plan: RunPlan) -> list[Controller]:
    return [controller(plan, agent_name(node)) for node in plan.tree.nodes]


def stages_of_agents(plan: RunPlan) -> dict[str, list[tuple[Stage, ...]]]:
    """Return the stages of each agent, the plant first, in the cycles until they repeat."""
    commands = map(COMMAND.of, plan.tree.devices)
    awaited = (*commands, *map(MEMORY.of, plan.tree.meters))
    cycles = range(plan.control.periods.longest)
    found: dict[str, list[tuple[Stage, ...]]] = {}
    found[PLANT] = [(Stage("sense", (), timed=True), Stage("apply", awaited)) for _ in cycles]
    for one in controllers(plan):
        found[one.name] = [tuple(one.stages(cycle)) for cycle in cycles]
    return found
