"""The recorder by hand: `python -m recordings --plan RUN/plan.json`."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from agents.launcher_link import LauncherLink
from agents.plan import load_plan
from bus_schemas.errors import InputError
from bus_schemas.tree import RECORDER
from recordings.record.recorder import run_recorder


def main() -> int:
    """Record the run of a plan. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m recordings", description=__doc__)
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    options = parser.parse_args()
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
    try:
        plan = load_plan(options.plan)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return run_recorder(plan, options.plan.parent, LauncherLink(RECORDER))


if __name__ == "__main__":
    sys.exit(main())
