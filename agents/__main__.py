"""One controller by hand: `python -m agents c2/inv07 --plan RUN/plan.json`."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from agents.launcher_link import LauncherLink
from agents.plan import load_plan
from agents.process import run_controller
from bus_schemas.errors import InputError
from bus_schemas.tree import CENTRAL, PLANT, RECORDER


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m agents", description=__doc__)
    parser.add_argument("agent", help=f"{CENTRAL}, or a path in the control tree such as c2/inv07")
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    options = parser.parse_args()
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
    try:
        plan = load_plan(options.plan)
        names = [name for name in plan.processes if name not in {PLANT, RECORDER}]
        if options.agent not in names:
            raise InputError(f"{options.agent}: expected one of {', '.join(names)}")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return run_controller(plan, options.agent, LauncherLink(options.agent))


if __name__ == "__main__":
    sys.exit(main())
