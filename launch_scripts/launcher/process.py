"""One process of a run; by hand: `python -m launch_scripts.launcher.process AGENT --plan PLAN`."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from agents.cycle import kind_of
from agents.launcher_link import LauncherLink
from agents.plan import RunPlan, load_plan
from agents.process import run_controller
from bus_schemas.errors import InputError
from recordings.record.recorder import run_recorder
from sim_plant.plant_run import run_plant
from sim_plant.profile import load_profile


def run_process(
    agent: str,
    plan: RunPlan,
    link: LauncherLink,
    folder: Path,
    patience_s: float,
    *,
    rejoins: bool = False,
) -> int:
    """Be the process of an agent in the run of a folder. Returns the exit status.

    The plant waits `patience_s` for everybody; who `rejoins` finds the run under way.
    """
    match kind_of(agent, plan.tree):
        case "recorder":
            return run_recorder(plan, folder, link)
        case "plant":
            return run_plant(plan, load_profile(folder / "profile.npz"), link, patience_s, folder)
        case _:
            return run_controller(plan, agent, link, rejoins=rejoins)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("agent", help="recorder, plant, central, or a path such as c2/inv07")
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    options = parser.parse_args()
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
    try:
        plan = load_plan(options.plan)
        if options.agent not in plan.processes:
            raise InputError(f"{options.agent}: expected one of {', '.join(plan.processes)}")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    link = LauncherLink(options.agent)
    return run_process(options.agent, plan, link, options.plan.parent, patience_s=600.0)


if __name__ == "__main__":
    sys.exit(main())
