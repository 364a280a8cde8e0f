"""One process of a run.

A controller can be started by hand: `python -m launch_scripts.process AGENT --plan PLAN`.
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from agents.cycle import kind_of
from agents.plan import RunPlan
from agents.plan_file import load_plan
from agents.process.agent_process import run_controller
from agents.process.launcher_link import LauncherLink
from bus_schemas.errors import InputError
from bus_schemas.tree import OPERATOR, PLANT, RECORDER, ROOT
from recordings.record.recorder import run_recorder
from sim_plant.order_desk import OrderDesk, PlantAtDesk
from sim_plant.plant import Plant
from sim_plant.plant_run import run_plant
from sim_plant.profile import PROFILE_NAME, load_profile
from sim_plant.real_inverters import PlantWithDevices
from sunspec.pipes import PlantPipes


def run_process(
    agent: str,
    plan: RunPlan,
    link: LauncherLink,
    folder: Path,
    *,
    rejoins: bool = False,
) -> int:
    """Be the process of an agent in the run of a folder. Returns the exit status.

    `rejoins`: The run is under way.
    """
    match kind_of(agent, plan.tree):
        case "recorder":
            return run_recorder(plan, folder, link)
        case "plant":
            with OrderDesk(folder, plan.tree.rating_kw(ROOT)) as desk:
                return run_plant(plan, lambda: PlantAtDesk(_plant(plan, folder), desk), link)
        case _:
            return run_controller(plan, agent, link, rejoins=rejoins)


def _plant(plan: RunPlan, folder: Path) -> Plant:
    profile = load_profile(folder / PROFILE_NAME, plan.timing.cycles, len(plan.inverters))
    if plan.site.devices:
        return PlantWithDevices(plan, profile, PlantPipes(plan, folder))
    return Plant(plan, profile)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("agent", help="central, or a path such as c2/inv07")
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    options = parser.parse_args()
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
    try:
        plan = load_plan(options.plan)
        controllers = [one for one in plan.processes if one not in {RECORDER, PLANT, OPERATOR}]
        if options.agent not in controllers:
            raise InputError(f"{options.agent}: expected one of {', '.join(controllers)}")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return run_controller(plan, options.agent, LauncherLink(options.agent))


if __name__ == "__main__":
    sys.exit(main())
