"""`heliarch node`: the agents of one host, which take part in a run that is launched on another."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from agents.plan import RunPlan, changed
from bus_schemas.errors import InputError
from bus_schemas.tree import PLANT
from launch_scripts.fork_requests import Start
from launch_scripts.restarts import Restarts
from launch_scripts.run_folder import RunFolder
from launch_scripts.supervision import Children, ForkServerProcess
from launch_scripts.watch import Watch


def share_of(plan: RunPlan, host: str) -> tuple[str, ...]:
    """Return the agents that a plan has for a host."""
    agents = tuple(agent for agent in plan.elsewhere if plan.access.addresses.get(agent) == host)
    if not agents:
        hosts = ", ".join(dict.fromkeys(plan.access.addresses.values()))
        raise InputError(
            f"--host: expected a host of the plan ({hosts or 'it has none'}), got {host}"
        )
    return agents


def run_share(
    plan: RunPlan,
    agents: Sequence[str],
    folder: RunFolder,
    server: ForkServerProcess,
    say: Callable[[str], None],
) -> None:
    """Start agents of a plan and see them through its run.

    Raises RunFailure: One of them ended before the run, and the policy does not start it again.
    """
    folder.make()
    folder.write_plan(plan)

    def start(*names: str, again: bool = True) -> None:
        starts = restarts.counts[names[0]] if again else 0
        server.ask(Start(str(folder.plan), names, str(folder.logs), 0.0, again, starts))

    with Children(server, plan, agents, folder.logs) as children:
        # The launcher alone does what fault rules ask for.
        watch = Watch(plan, children.rows, say)
        restarts = Restarts(changed(plan, faults={"rules": ()}), children, watch, start, say)
        start(*agents, again=False)
        restarts.begin(time.monotonic())
        are_ready = False
        while not all(child.finished and child.exited for child in children):
            children.events(0.1)
            if not are_ready and all(child.ready for child in children):
                are_ready = True
                where = f"{plan.access.host_of(PLANT)}:{plan.access.tcp_ports[PLANT]}"
                say(f"all are ready for the plant at {where}")
            restarts.look()
            if not plan.timing.lockstep:
                # No recorder hears them here: each says every second that it is there.
                running = [c.agent for c in children if c.ready and not c.finished]
                restarts.judge(running, 0.0)
