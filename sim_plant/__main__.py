"""The plant simulator as a process: `python -m sim_plant --plan RUN/plan.json`."""

from __future__ import annotations

import argparse
import logging
import sys
import threading
from pathlib import Path

from agents.drop_log import DropLog
from agents.events import Failed, Joined
from agents.joining import open_bus
from agents.lifeline import Lifeline
from agents.plan import RunPlan, load_plan
from agents.process_setup import join_run, settle_in
from agents.runtime import Runtime
from bus_schemas.errors import InputError
from sim_plant.conductor import ArmingError, Conductor
from sim_plant.plant import Plant, PlantState
from sim_plant.profile import Profile, load_profile

log = logging.getLogger("sim_plant")


def main() -> int:
    """Run the plant of a plan. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m sim_plant", description=__doc__)
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    parser.add_argument("--profile", type=Path, help="default: profile.npz beside the plan")
    parser.add_argument(
        "--patience", type=float, default=30.0, help="seconds to wait for everybody to appear"
    )
    parser.add_argument("--attached", action="store_true", help="a launcher holds standard input")
    options = parser.parse_args()
    join_run(options.attached)
    try:
        plan = load_plan(options.plan)
        profile = load_profile(options.profile or options.plan.with_name("profile.npz"))
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    settle_in(plan, "plant")
    return run_plant(plan, profile, options.attached, options.patience)


def run_plant(plan: RunPlan, profile: Profile, attached: bool, patience_s: float) -> int:
    """Join the bus and conduct the run. Returns the exit status."""
    drop_log = DropLog()
    stop_asked = threading.Event()
    # The launcher knows one word for the plant: stop.
    lifeline = Lifeline(attached, on_word=lambda word: stop_asked.set())
    plant = Plant(plan.tree, profile, plan.actuator)
    try:
        with open_bus(plan, plant.name, drop_log) as bus:
            runtime: Runtime[PlantState] = Runtime(plant, plan, bus, lifeline, drop_log)
            lifeline.tell(Joined())
            Conductor(runtime, stop_asked, patience_s).conduct()
    except ArmingError as error:
        lifeline.tell(Failed(str(error)))
        return 1
    except Exception as error:
        log.exception("the plant gives up")
        lifeline.tell(Failed(f"{type(error).__name__}: {error}"))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
