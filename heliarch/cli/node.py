"""`heliarch node`: the controllers of one host in a run that is launched on another one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from agents.plan import changed
from agents.plan_file import load_plan
from bus_schemas.errors import InputError
from heliarch.cli.output import Output


def node(
    *,
    plan: Path,
    host: Annotated[str, Parameter(metavar="ADDRESS")],
    keys: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    out: Annotated[Path | None, Parameter(metavar="DIR")] = None,
) -> None:
    """Run the controllers that `launch --on` puts on this host.

    Waits for the plant, takes part in the run, and ends with it. Exit status 1: a controller ended
    before the run, or the plant disappeared.

    Example: `heliarch node --plan plan.json --host 10.0.0.2`

    Parameters
    ----------
    plan
        The plan.json of the run, or a copy of it.
    host
        This host's address, as in launch --on.
    keys
        Folder of the keys; default keys/PLANT.
    out
        Folder of the logs; default runs/PLANT-TIME.
    """
    from launch_scripts.fork_server_process import fork_server
    from launch_scripts.node import run_share, share_of
    from launch_scripts.run_folder import new_run_id, run_folder

    run_plan, output = load_plan(plan), Output()
    agents = share_of(run_plan, host)
    if run_plan.access.keys_folder:
        from scenarios.plant_keys import check_keys  # Its package is optional.

        own = (keys or Path("keys") / run_plan.plant).absolute()
        run_plan = changed(run_plan, access={"keys_folder": str(own)})
        check_keys(run_plan, agents)
    elif keys is not None:
        raise InputError.of("--keys", f"expected a plan with keys, got {plan}, which has none")
    folder = run_folder(new_run_id(run_plan.plant), out)
    with fork_server() as server:
        number = f"{len(agents)} processes of {run_plan.plant}"
        output.say(f"{number} on {host}, logs in {folder.logs}")
        run_share(run_plan, agents, folder, server, output.say)
    output.say("the run is over")
