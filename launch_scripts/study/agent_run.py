"""The agents of a run called one after the other, with no bus between them.

In lockstep every message of a cycle arrives. Then neither bus nor sequencer decides anything: which
agent can go on follows from who has spoken. That order is found out once for each kind of cycle and
repeated. The messages are those of `simulate` and `launch`; a test holds them equal.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from agents.agent import Agent, Turn
from agents.plan import RunPlan
from agents.team import controllers
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.supervision import RunFailure
from sim_plant.plant import Plant
from sim_plant.profile import Profile

Said: TypeAlias = dict[Port[Message], Message]
Order: TypeAlias = list[tuple[int, str]]
"""Number of an agent and the name of the stage that it closes, one after the other."""


class AgentRun:
    """A run in memory, in lockstep, without a bus.

    Parameters
    ----------
    plan, profile
        The run.
    see
        Called with every message, in an order in which it could have been sent.
    """

    def __init__(
        self, plan: RunPlan, profile: Profile, see: Callable[[Port[Message], Message], None]
    ) -> None:
        self._plan = plan
        self._see = see
        self._team: list[Agent[Any]] = [
            Plant(plan.tree, profile, plan.actuator),
            *controllers(plan),
        ]
        self._states = [agent.initial_state() for agent in self._team]
        self._orders: dict[int, Order] = {}

    def run(self) -> None:
        """Run all cycles.

        Raises
        ------
        RunFailure
            The agents wait for each other.
        """
        for cycle in range(self._plan.cycles):
            # Who acts in a cycle is the same after each round of the slowest tier.
            kind = cycle % self._plan.periods.longest
            order = self._orders.get(kind)
            if order is None:
                self._orders[kind] = self._explore(cycle)
            else:
                said: Said = {}
                for number, stage in order:
                    self._step(cycle, number, stage, said)

    def _explore(self, cycle: int) -> Order:
        """Run a cycle, each agent as soon as it can go on; return the order that it took."""
        said: Said = {}
        order: Order = []
        kind = tuple(agent.stages(cycle) for agent in self._team)
        places = [0] * len(kind)
        while any(place < len(stages) for place, stages in zip(places, kind, strict=True)):
            went_on = False
            for number, stages in enumerate(kind):
                if places[number] < len(stages) and stages[places[number]].awaits <= said.keys():
                    stage = stages[places[number]].name
                    self._step(cycle, number, stage, said)
                    order.append((number, stage))
                    places[number] += 1
                    went_on = True
            if not went_on:
                raise RunFailure(f"stalled in cycle {cycle}: the agents wait for each other")
        return order

    def _step(self, cycle: int, number: int, stage: str, said: Said) -> None:
        sim_time_ns = self._plan.sim_time_ns(cycle)
        agent = self._team[number]
        # An agent asks for its own ports only, so it may be shown all that was said.
        turn = Turn(stage, cycle, sim_time_ns, (cycle, sim_time_ns, agent.name, ()), said)
        self._states[number], outputs = agent.step(self._states[number], turn)
        for port, message in outputs:
            said[port] = message
            self._see(port, message)
