"""`heliarch node`: the agents of one host, which take part in a run that is launched on another."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from agents.plan import RunPlan, changed
from agents.process.events import Failed, Start
from bus_schemas.errors import FailureError, InputError
from bus_schemas.tree import PLANT
from launch_scripts.restarts import Restarts
from launch_scripts.run_folder import RunFolder
from launch_scripts.supervision import Children, ForkServerProcess
from launch_scripts.watch import Watch


def share_of(plan: RunPlan, host: str) -> tuple[str, ...]:
    """Return the processes that a plan has for a host."""
    agents = tuple(name for name in plan.processes if plan.access.addresses.get(name) == host)
    if not agents:
        hosts = ", ".join(dict.fromkeys(plan.access.addresses.values()))
        raise InputError.of(
            "--host", f"expected a host of the plan ({hosts or 'it has none'}), got {host}"
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

    Raises FailureError: One of them ended before the run, and the policy does not start it again.
    """
    folder.make()
    folder.write_plan(plan)

    def start(*names: str, again: bool = True) -> None:
        server.ask(Start(str(folder.plan), names, str(folder.logs), again))

    with Children(server, plan, agents, folder.logs) as children:
        watch = Watch(plan, children)
        # The launcher alone does what fault rules ask for.
        restarts = Restarts(changed(plan, faults={"rules": ()}), children, watch, start, say)
        start(*agents, again=False)
        are_ready = False
        while not all(child.finished or child.row.state == "given up" for child in children):
            for child, event in children.events(0.1):
                watch.hear(child, event)
                if isinstance(event, Failed):
                    raise children.failure(child.agent, f"{child.agent} gave up: {event.text}")
            if not are_ready and all(child.ready for child in children):
                are_ready = True
                restarts.begin(time.monotonic())
                where = f"{plan.access.host_of(PLANT)}:{plan.access.tcp_ports[PLANT]}"
                say(f"all are ready for the plant at {where}")
            restarts.look()
        children.await_end([*children], 10.0)
    if restarts.given_up:
        raise FailureError(f"given up in the run: {', '.join(restarts.given_up)}")
