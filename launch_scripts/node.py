"""`heliarch node`: the agents of one host, which take part in a run that is launched on another."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from agents.plan import RunPlan, changed
from agents.process.events import Failed
from agents.process.machine import take_files
from bus_schemas.errors import FailureError, InputError
from bus_schemas.tree import PLANT
from launch_scripts.fork_server_process import ForkServer
from launch_scripts.processes import Processes
from launch_scripts.run_folder import RunFolder


def share_of(plan: RunPlan, host: str) -> tuple[str, ...]:
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
    server: ForkServer,
    say: Callable[[str], None],
) -> None:
    """Start agents of a plan and see them through its run.

    Raises FailureError: One of them ended before the run, and the policy does not start it again.
    """
    take_files(len(plan.processes))
    folder.make()
    folder.write_plan(plan)

    # The launcher alone does what fault rules ask for.
    plan = changed(plan, faults={"rules": ()})
    with Processes(server, plan, agents, folder, say) as processes:
        processes.start()
        own = processes.own
        while not all(one.finished or one.state == "given up" for one in own):
            for process, event in processes.look():
                if isinstance(event, Failed):
                    text = f"{process.name} gave up: {event.text}"
                    raise processes.failure(process.name, text)
            if not processes.has_begun and all(process.is_there for process in own):
                processes.begin(time.monotonic())
                say(f"all are ready for the plant at {plan.access.endpoint(PLANT)}")
        processes.await_end(own, 10.0)
        given_up = processes.given_up
    if given_up:
        raise FailureError(f"given up in the run: {', '.join(given_up)}")
