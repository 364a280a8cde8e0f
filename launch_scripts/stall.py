"""Why a run in lockstep stalls: who waits for whom."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from agents.cycle import stage_place
from agents.plan import RunPlan
from agents.process.events import Waiting
from bus_schemas.errors import listed


def who_waits(
    waiting: Mapping[str, Waiting], plan: RunPlan, stopped: Collection[str] = ()
) -> tuple[str, list[str]]:
    """Return one line on which processes of a stalled run wait for which, and those to blame.

    To blame are processes that a signal has stopped; else those that others wait for and that do
    not wait in the same cycle; else those that wait in the earliest stage: their inputs were sent.
    """
    first = min(event.cycle for event in waiting.values())
    stuck = {agent: event for agent, event in waiting.items() if event.cycle == first}
    needed: dict[str, list[str]] = {}
    for agent, event in stuck.items():
        for port, publisher in event.needs:
            process = plan.wiring.process_of(publisher)
            needed.setdefault(process, []).append(f"{agent} waits for {port}")
    places = {name: stage_place(name, one.stage, plan.tree) for name, one in stuck.items()}
    earliest = [agent for agent, place in places.items() if place == min(places.values())]
    to_blame = [*stopped] or [agent for agent in needed if agent not in stuck] or earliest
    what = "stopped by a signal:" if stopped else "nothing that can be used came from"
    waits = [line for agent in to_blame for line in needed.get(agent, ())]
    if to_blame is earliest:
        what, waits = "what they wait for was sent to", []
    line = f"stalled in cycle {first}: {what} {listed(to_blame)}"
    return "; ".join(filter(None, (line, listed(waits)))), to_blame
