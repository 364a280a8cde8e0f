"""One process of a run; by hand: `python -m launch_scripts.process AGENT --plan PLAN`."""

from __future__ import annotations

import argparse
import logging
import sys
from math import inf
from pathlib import Path

from agents.cycle import kind_of
from agents.plan import RunPlan
from agents.plan_file import load_plan
from agents.process.agent_process import run_controller
from agents.process.launcher_link import LauncherLink
from bus_schemas.errors import InputError
from bus_schemas.tree import ROOT
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
    patience_s: float = inf,
    *,
    rejoins: bool = False,
) -> int:
    """Be the process of an agent in the run of a folder. Returns the exit status.

    The plant waits `patience_s` for all agents, or as long as the launcher lets it. `rejoins`: the
    run is under way.
    """
    match kind_of(agent, plan.tree):
        case "recorder":
            return run_recorder(plan, folder, link)
        case "plant":
            with OrderDesk(folder, plan.tree.rating_kw(ROOT)) as desk:
                return run_plant(
                    plan, lambda: PlantAtDesk(_plant(plan, folder), desk), link, patience_s
                )
        case _:
            return run_controller(plan, agent, link, rejoins=rejoins)


def _plant(plan: RunPlan, folder: Path) -> Plant:
    profile = load_profile(folder / PROFILE_NAME, plan.timing.cycles, len(plan.inverters))
    if plan.site.devices:
        return PlantWithDevices(plan, profile, PlantPipes(plan, folder))
    return Plant(plan, profile)


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
