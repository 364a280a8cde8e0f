"""`heliarch node`: the agents of one host, which take part in a run that is launched on another."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from msgspec.structs import replace

from agents.plan import RunPlan
from agents.process import STANDING_S
from bus_schemas.errors import InputError
from bus_schemas.tree import PLANT
from launch_scripts.launcher.fork_requests import Start
from launch_scripts.launcher.restarts import Restarts
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.supervision import Children, ForkServerProcess

_SILENT_S: Final = 2.0 * STANDING_S
"""An agent that has not said for so long that it is there says nothing."""

_UNIT: Final = """\
[Unit]
Description=Heliarch: agents of {plan.plant} on {host}
Wants=network-online.target
After=network-online.target
StartLimitIntervalSec=0

[Service]
ExecStart={command}
WorkingDirectory={folder}
Restart=always
RestartSec=1
LimitRTPRIO=99

[Install]
WantedBy=multi-user.target
"""


def share_of(plan: RunPlan, host: str) -> tuple[str, ...]:
    """Return the agents that a plan has for a host."""
    agents = tuple(agent for agent in plan.elsewhere if plan.addresses.get(agent) == host)
    if not agents:
        hosts = ", ".join(dict.fromkeys(plan.addresses.values()))
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
        server.ask(Start(str(folder.plan), names, str(folder.logs), 0.0, again))

    with Children(server, plan, agents, folder.logs) as children:
        # The launcher alone does what fault rules ask for.
        restarts = Restarts(replace(plan, faults=()), children, start, say)
        start(*agents, again=False)
        restarts.begin(time.monotonic())
        are_ready = False
        while not all(child.finished and child.exited for child in children):
            children.events(0.1)
            if not are_ready and all(child.ready for child in children):
                are_ready = True
                say(f"all are ready for the plant at {plan.host_of(PLANT)}:{plan.tcp_ports[PLANT]}")
            restarts.look(0.0)
            if not plan.lockstep:
                silent_since = time.monotonic() - _SILENT_S
                silent = [
                    child.agent
                    for child in children
                    if child.ready and not child.finished and child.heard_at < silent_since
                ]
                restarts.note_silence(silent, _SILENT_S)


def systemd_unit(plan: RunPlan, path: Path, host: str) -> str:
    """Return a systemd unit that runs the agents of a host, for one run after another."""
    words = [sys.executable, "-m", "launch_scripts", "node"]
    words += ["--plan", str(path.absolute()), "--host", host]
    words += ["--keys", plan.keys_folder] if plan.keys_folder else []
    return _UNIT.format(plan=plan, host=host, command=shlex.join(words), folder=Path.cwd())
