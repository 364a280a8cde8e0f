"""Finds agents that are cut off, by the messages that their listeners lacked in a cycle."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping

from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import ROOT, agent_name, parent_of


class Listeners:
    """Which listener awaits messages of which agents.

    A listener that lacks most agents that were heard is itself cut off and no evidence against
    others. Otherwise an agent is cut off if its parent, or half of its listeners, lack it.
    """

    def __init__(self, plan: RunPlan, publishers: Mapping[Port[Message], str]) -> None:
        self._publisher = {str(port): publishers[port] for port in plan.wiring.ports}
        self._parent = {
            agent_name(node): agent_name(parent_of(node))
            for node in plan.tree.nodes
            if node != ROOT
        }
        # How many cycles there are between awaited messages, by listener and publisher.
        self._steps = defaultdict[str, dict[str, int]](dict)
        self._listening = defaultdict[str, set[str]](set)
        for listener, turns in stages_of_agents(plan).items():
            for port in (port for stages in turns for stage in stages for port in stage.awaits):
                step, steps = plan.control.period(port), self._steps[listener]
                publisher = publishers[port]
                steps[publisher] = min(step, steps.get(publisher, step))
                self._listening[publisher].add(listener)

    def publishers(self, keys: Collection[str]) -> set[str]:
        return {self._publisher[key] for key in keys}

    def cut_off(
        self, cycle: int, lacked: Mapping[str, set[str]], recorded: Collection[str]
    ) -> dict[str, int]:
        """Return the agents cut off in a cycle, each with the cycles until it is awaited again.

        lacked: Agents, by listener that lacked them.
        recorded: Agents of which a message was recorded.
        """
        found: dict[str, int] = {}
        lacking = defaultdict[str, set[str]](set)
        for listener, publishers in lacked.items():
            steps = self._steps[listener].items()
            heard = {one for one, step in steps if cycle % step == 0 and one in recorded}
            if 2 * len(publishers & heard) > len(heard):
                found[listener] = 1
                continue
            for publisher in publishers:
                lacking[publisher].add(listener)
        for publisher, listeners in lacking.items():
            all_listeners = self._listening[publisher]
            is_parents = self._parent.get(publisher) in listeners
            if is_parents or 2 * len(listeners) >= len(all_listeners):
                found[publisher] = min(self._steps[one][publisher] for one in all_listeners)
        return found
