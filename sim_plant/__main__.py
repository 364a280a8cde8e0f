"""The plant simulator by hand: `python -m sim_plant --plan RUN/plan.json`."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from agents.launcher_link import LauncherLink
from agents.plan import load_plan
from bus_schemas.errors import InputError
from bus_schemas.tree import PLANT
from sim_plant.plant_run import run_plant
from sim_plant.profile import load_profile


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m sim_plant", description=__doc__)
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    parser.add_argument("--profile", type=Path, help="default: profile.npz beside the plan")
    parser.add_argument(
        "--patience", type=float, default=30.0, help="seconds to wait for everybody to appear"
    )
    options = parser.parse_args()
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
    try:
        plan = load_plan(options.plan)
        profile = load_profile(options.profile or options.plan.with_name("profile.npz"))
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    folder = options.plan.parent
    return run_plant(plan, profile, LauncherLink(PLANT), options.patience, folder)


if __name__ == "__main__":
    sys.exit(main())
