"""How far the clocks of other hosts are from the launcher's, worked out from a recording.

A message from host to host seems to take its travel time plus the time by which the listener's
clock is ahead. If the network is equally fast both ways, the fastest messages each way give both:
half their difference is how far the clock is ahead, half their sum the travel time. If it is not,
the clock may be off by as much as the travel time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import Any

import msgspec

from agents.plan import RunPlan
from bus_schemas.tree import PLANT
from results.timing.stage_times import MessageTimes, StageTimes

ACROSS = " *"
"""Marks rows of messages between two clocks."""


class ClockOffset(msgspec.Struct, frozen=True):
    """The clock of another host, or of a device.

    name: Address of the host, or name of the device.
    agents: The agents on that clock.
    ahead_us: How far it is ahead of the launcher's; where `heliarch node` sets it, this is what is
        left.
    within_us: How far off this may be: half the fastest round trip.
    """

    name: str
    agents: tuple[str, ...]
    ahead_us: float
    within_us: float


def clock_of(agent: str, plan: RunPlan) -> str:
    """Return what has the clock of an agent: an address or a device; empty: the launcher's host."""
    if agent in plan.access.external and agent != PLANT:
        return agent
    return plan.access.addresses.get(agent, "")


def clock_offsets(messages: MessageTimes, stages: Sequence[StageTimes]) -> tuple[ClockOffset, ...]:
    """Return the offsets of other hosts' and devices' clocks, from the messages of a run."""
    plan = messages.plan
    members: dict[str, list[str]] = {}
    for agent in plan.elsewhere:
        if name := clock_of(agent, plan):
            members.setdefault(name, []).append(agent)
    # The fastest message to each clock from the launcher's host, and back.
    there, back = (dict.fromkeys(members, inf) for _ in range(2))
    for port, fastest_ns in messages.fastest_ns.items():
        if name := clock_of(port.publisher, plan):
            back[name] = min(back[name], fastest_ns)
    for stage in stages:
        listener, closed = clock_of(stage.agent, plan), stage.closed[~stage.closed.lacking]
        hops_ns = (closed.ready_ns - closed.completed_ns).dropna()
        by_port: dict[Any, float] = hops_ns.groupby(closed.cause, sort=False).min().to_dict()
        for port, hop_ns in by_port.items():
            publisher = clock_of(port.publisher, plan)
            if bool(listener) != bool(publisher):
                fastest, name = (there, listener) if listener else (back, publisher)
                fastest[name] = min(fastest[name], hop_ns)
    return tuple(
        ClockOffset(
            name,
            tuple(agents),
            (there[name] - back[name]) / 2e3,
            (there[name] + back[name]) / 2e3,
        )
        for name, agents in members.items()
        # A round trip that takes no time is none: the device does not state when inputs came.
        if 0 <= there[name] + back[name] < inf
    )


def on_one_clock(messages: MessageTimes, clocks: Sequence[ClockOffset]) -> MessageTimes:
    """Return the times of messages as the launcher's clock would have shown them."""
    ahead_ns = {agent: round(one.ahead_us * 1e3) for one in clocks for agent in one.agents}
    of_ports = [ahead_ns.get(port.publisher, 0) for port in messages.ports]
    ready_ns, publish_ns = messages.ready_ns - of_ports, messages.publish_ns - of_ports
    return replace(messages, ready_ns=ready_ns, publish_ns=publish_ns)
