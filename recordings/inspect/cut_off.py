"""Who is cut off: judged by what those who await an agent's messages lacked in a cycle."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection

from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.tree import ROOT, agent_name, parent_of


class Listeners:
    """The agents that lacked messages in a cycle, and whose messages they lacked.

    A listener that lacks most agents that were heard is cut off itself, and what it lacks says
    nothing of the others. Otherwise an agent is cut off whose parent, or half of whose listeners,
    lack it.
    """

    def __init__(self, plan: RunPlan) -> None:
        self._publisher = {str(port): port.publisher for port in plan.wiring.ports}
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
                steps[port.publisher] = min(step, steps.get(port.publisher, step))
                self._listening[port.publisher].add(listener)
        self._lacked: dict[str, set[str]] = {}
        self._cut_off: dict[str, int] | None = {}

    def lack(self, listener: str, keys: Collection[str]) -> None:
        self._lacked.setdefault(listener, set()).update(self._publisher[key] for key in keys)
        self._cut_off = None

    def cut_off(self, cycle: int, is_heard: Callable[[str], bool]) -> dict[str, int]:
        """Return who is cut off in the cycle, and for how many cycles no listener will say more."""
        if self._cut_off is None:
            self._cut_off = self._judged(cycle, is_heard)
        return self._cut_off

    def next_cycle(self) -> None:
        self._lacked, self._cut_off = {}, {}

    def _judged(self, cycle: int, is_heard: Callable[[str], bool]) -> dict[str, int]:
        found: dict[str, int] = {}
        lacking = defaultdict[str, set[str]](set)
        for listener, lacked in self._lacked.items():
            steps = self._steps[listener].items()
            heard = {one for one, step in steps if cycle % step == 0 and is_heard(one)}
            if 2 * len(lacked & heard) > len(heard):
                found[listener] = 1
                continue
            for publisher in lacked:
                lacking[publisher].add(listener)
        for publisher, listeners in lacking.items():
            all_listeners = self._listening[publisher]
            is_parents = self._parent.get(publisher) in listeners
            if is_parents or 2 * len(listeners) >= len(all_listeners):
                found[publisher] = min(self._steps[one][publisher] for one in all_listeners)
        return found
