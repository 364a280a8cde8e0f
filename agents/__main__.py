"""One controller as a process: `python -m agents direct --node c2/inv07 --plan RUN/plan.json`."""

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
from agents.team import (
    Controller,
    central_controller,
    check_node,
    direct_controller,
    supervisor,
)
from bus_schemas.errors import InputError
from bus_schemas.tree import CENTRAL

log = logging.getLogger("agents")


def main() -> int:
    """Run the controller that the command line names. Returns the exit status."""
    options = _parser().parse_args()
    join_run(options.attached)
    try:
        plan = load_plan(options.plan)
        check_node(plan, options.kind, options.node)
        controller = _controller(plan, options.kind, options.node)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    # The launcher knows one word for a controller: stop.
    dismissed = threading.Event()
    lifeline = Lifeline(options.attached, on_word=lambda word: dismissed.set())
    settle_in(plan, options.kind)
    return run_controller(controller, plan, lifeline, dismissed)


def run_controller(
    controller: Controller, plan: RunPlan, lifeline: Lifeline, dismissed: threading.Event
) -> int:
    """Join the bus and take the controller through the run. Returns the exit status."""
    drop_log = DropLog()
    try:
        with open_bus(plan, controller.name, drop_log) as bus:
            runtime = Runtime(controller, plan, bus, lifeline, drop_log)
            lifeline.tell(Joined())
            log.info("%s is on the bus", controller.name)
            runtime.run(dismissed)
    except Exception as error:
        log.exception("%s gives up", controller.name)
        lifeline.tell(Failed(f"{type(error).__name__}: {error}"))
        return 1
    return 0


def _controller(plan: RunPlan, kind: str, node: str) -> Controller:
    match kind:
        case "direct":
            return direct_controller(plan, node)
        case "supervisor":
            return supervisor(plan, node)
        case _:
            return central_controller(plan)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m agents", description=__doc__)
    parser.add_argument("kind", choices=["direct", "supervisor", "central"])
    parser.add_argument("--node", default=CENTRAL, help="path in the control tree, e.g. c2/inv07")
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    parser.add_argument(
        "--attached",
        action="store_true",
        help="a launcher holds standard input: end when it ends",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
