"""The recorder as a process of a run."""

from __future__ import annotations

import logging
import signal
from pathlib import Path

from agents.drop_log import DropLog
from agents.events import Joined, RecordingEnded
from agents.launcher_link import LauncherLink
from agents.machine import stand_back
from agents.plan import RunPlan
from agents.process import run_guarded, session_settings, set_up_process
from bus_schemas.tree import RECORDER
from bus_schemas.zenoh_bus import ZenohTap
from recordings.read.run_file import RECORDING_NAME
from recordings.record.recorder import Recorder, RecordingEnd
from recordings.record.writer import RunWriter

log = logging.getLogger(__name__)


def run_recorder(plan: RunPlan, folder: Path, link: LauncherLink, *, attached: bool) -> int:
    """Record a run into its folder until the launcher says so or is gone. Returns the status."""
    end = RecordingEnd()
    # Whatever ends the run, the file must be closed in order.
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: end.ask())
    set_up_process(plan, RECORDER)

    def run() -> None:
        scenario = (folder / "scenario.toml").read_text(encoding="utf-8")

        def on_end(text: str) -> None:
            log.error("%s", text)
            link.tell(RecordingEnded(text))

        path = folder / RECORDING_NAME
        writer = RunWriter(path, plan, scenario, driver="launch", on_end=on_end)
        with ZenohTap(RECORDER, plan.keys, session_settings(plan, RECORDER)) as tap:
            link.tell(Joined())
            if not plan.lockstep:
                stand_back()
            Recorder(plan, tap, writer, link, end, DropLog(), attached).run()

    return run_guarded(RECORDER, link, run)
