"""`heliarch node`: the controllers of one host in a run that is launched on another one."""

from __future__ import annotations

from pathlib import Path

import typer
from msgspec.structs import replace

from bus_schemas.errors import InputError
from launch_scripts.commands.output import say
from studies.tables import console_for


def node(
    *,
    plan: Path,
    host: str,
    keys: Path | None = None,
    out: Path | None = None,
    systemd: bool = False,
) -> None:
    """Run the controllers that `launch --on` puts on this host.

    Waits for the plant, takes part in the run, and ends with it. Exit
    status 1: a controller ended before the run, or the plant disappeared.

    --plan: The plan.json of the run, or a copy of it.
    --host ADDRESS: This host's address, as in launch --on.
    --keys DIR: Folder of the keys; default keys/PLANT.
    --out DIR: Folder of the logs; default runs/PLANT-TIME.
    --systemd: Only print a systemd unit that starts this command again whenever it ends.
    Example: heliarch node --plan plan.json --host 10.0.0.2
    """
    from agents.plan import load_plan
    from launch_scripts.launcher.node import run_share, share_of, systemd_unit
    from launch_scripts.launcher.run_folder import new_run_id, run_folder
    from launch_scripts.launcher.supervision import ForkServerProcess

    run_plan = load_plan(plan)
    agents = share_of(run_plan, host)
    if run_plan.keys_folder:
        from launch_scripts.scenarios.plant_keys import check_keys  # Its package is optional.

        own = (keys or Path("keys") / run_plan.plant).absolute()
        run_plan = replace(run_plan, keys_folder=str(own))
        check_keys(run_plan, agents)
    elif keys is not None:
        raise InputError(f"--keys: expected a plan with keys, got {plan}, which has none")
    if systemd:
        typer.echo(systemd_unit(run_plan, plan, host), nl=False)
        return
    console = console_for(None)
    folder = run_folder(new_run_id(run_plan.plant), out)
    with ForkServerProcess() as server:
        say(console, f"{len(agents)} agents of {run_plan.plant} on {host}, logs in {folder.logs}")
        run_share(run_plan, agents, folder, server, lambda line: say(console, line))
    say(console, "the run is over")
