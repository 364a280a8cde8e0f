"""Begins and ends a run: the barrier before cycle 0, the start, the stop.

Messages that are put on the bus right after a session opens can get lost before all declarations
have travelled. So nothing counts until the liveliness token of every agent is seen and one arming
round, a whole cycle with a number below 0, has come back to the plant and past the recorder.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from agents.agent import Agent
from agents.plan import RunPlan
from agents.process.agent_process import AgentProcess, run_guarded
from agents.process.events import Armed
from agents.process.launcher_link import LauncherLink
from bus_schemas.errors import FailureError, listed
from bus_schemas.signals import READY, RUN
from bus_schemas.tree import PLANT, ROOT
from sim_plant.inverters import PlantState

FIRST_ROUND: Final = -1_000_000
"""Cycle of the first arming round; the next ones count upwards."""

_QUIET_PER_AGENT_S: Final = 0.001
"""How much longer the plant waits for an arming round, for each agent."""

_ARMING_S: Final = 30.0
"""How long the arming rounds may take, once all agents are there."""

_LEAD_S: Final = 0.2
"""In real time: how long before cycle 0 the plant announces when it begins."""


def patience_s(number: int) -> float:
    """Return how long to wait for an arming round, counted from 1, before the next one [s].

    Most rounds fail because a link is not up yet, so the next one is tried soon. Later rounds have
    more time, for slow machines. The plant waits as long again whenever something of it comes.
    """
    return min(0.3 * float(1.25 ** min(number - 1, 20)), 3.0)


def run_plant(
    plan: RunPlan,
    make_plant: Callable[[], Agent[PlantState]],
    link: LauncherLink,
) -> int:
    """Join the bus and lead the run."""

    def run() -> None:
        with AgentProcess(plan, PLANT, [make_plant()], link) as process:
            _lead(process)

    return run_guarded(PLANT, link, run)


def _lead(process: AgentProcess) -> None:
    plan, loop = process.plan, process.loop
    _await_all(process)
    _arm(process, time.monotonic() + _ARMING_S)
    lead_s = 0.0 if plan.timing.lockstep else _LEAD_S
    start_time_ns = time.monotonic_ns() + round(lead_s * 1e9)
    process.driver.publish(RUN.of(ROOT), plan.run_message("start", 0, start_time_ns))
    process.link.tell(Armed(start_time_ns))
    loop.begin(start_time_ns, time.monotonic_ns())
    for _ in process.drive():
        if process.link.dismissed:
            loop.end_before(loop.cycle + 1)
    process.driver.publish(RUN.of(ROOT), plan.run_message("stop", loop.cycle, start_time_ns))
    process.report()


def _await_all(process: AgentProcess) -> None:
    """Wait until all processes are on the bus, or the launcher gives up."""
    alive_key = process.plan.wiring.alive_key
    others = {alive_key(name) for name in process.plan.processes if name != PLANT}
    tokens = process.watch_tokens()
    while not others <= tokens.alive():
        process.beat()
        time.sleep(0.005)


def _arm(process: AgentProcess, give_up_at: float) -> None:
    """Send rounds through the loop until one closes and is recorded."""
    plan, loop = process.plan, process.loop
    for number in range(1, -FIRST_ROUND):
        loop.enter(FIRST_ROUND + number, time.monotonic_ns())
        process.driver.advance(loop)
        quiet_s = patience_s(number) + _QUIET_PER_AGENT_S * len(plan.tree.nodes)
        if _round_closes(process, FIRST_ROUND + number, quiet_s):
            return
        if time.monotonic() > give_up_at:
            break
    # One agent that does not answer delays all others.
    needs = listed(sorted(map(str, loop.waiting)), most=3)
    raise FailureError(f"no arming round closed; the plant waits for {needs or 'the recorder'}")


def _round_closes(process: AgentProcess, cycle: int, quiet_s: float) -> bool:
    is_recorded, until = False, time.monotonic() + quiet_s
    while time.monotonic() < until:
        arrivals = process.driver.wait_and_act(longest_ns=round(until * 1e9))
        # Who publishes on its own must not keep a round open in which others are silent.
        of_round = [one for one in arrivals if one.message.cycle == cycle]
        if of_round:
            until = time.monotonic() + quiet_s
        is_recorded = is_recorded or any(one.port is READY.of(ROOT) for one in of_round)
        process.beat()
        if is_recorded and not process.loop.stage:
            return True
    return False
