"""The recorder as a process: `python -m recordings --plan RUN/plan.json`."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
from pathlib import Path

from agents.drop_log import DropLog
from agents.events import Failed, Joined
from agents.joining import session_settings
from agents.lifeline import Lifeline
from agents.plan import RunPlan, load_plan
from agents.process_setup import join_run, settle_in
from bus_schemas.errors import InputError
from bus_schemas.tree import RECORDER
from bus_schemas.zenoh_bus import ZenohTap
from recordings.recorder import Recorder, RecordingEnd
from recordings.writer import RECORDING_NAME, RunWriter

log = logging.getLogger("recordings")


def main() -> int:
    """Record the run of a plan. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m recordings", description=__doc__)
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    parser.add_argument("--attached", action="store_true", help="a launcher holds standard input")
    options = parser.parse_args()
    try:
        plan = load_plan(options.plan)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return record(plan, options.plan.parent, options.attached)


def record(plan: RunPlan, folder: Path, attached: bool) -> int:
    """Record a run into its folder, until the launcher says so or is gone."""
    # Made before anybody can ask for it: the launcher may die while this process starts.
    end = RecordingEnd()
    # Whatever ends the run, the file must be closed in order: SIGTERM, not SIGKILL.
    signal.signal(signal.SIGTERM, lambda *_: end.ask())
    join_run(attached, death_signal=signal.SIGTERM)
    settle_in(plan, "recorder")
    scenario = (folder / "scenario.toml").read_text(encoding="utf-8")
    lifeline = Lifeline(attached, on_word=end.hear, on_orphaned=end.ask)
    try:
        writer = RunWriter(folder / RECORDING_NAME, plan, scenario, driver="launch")
        with ZenohTap(RECORDER, plan.keys, session_settings(plan, RECORDER)) as tap:
            lifeline.tell(Joined())
            Recorder(plan, tap, writer, lifeline, end, DropLog(), attached).run()
    except Exception as error:
        log.exception("the recorder gives up")
        lifeline.tell(Failed(f"{type(error).__name__}: {error}"))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
