"""The runs in a folder, as a page lists them: what was run, with which faults, and how it ended."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import msgspec

from bus_schemas.errors import InputError, listed
from bus_schemas.tree import ROOT
from recordings.inspect.health import SUMMARY_NAME, LauncherAccount, failure_in
from recordings.read.mcap_file import read_outline
from recordings.read.run_file import RECORDING_NAME, read_origin
from scenarios.fault_rules import fault_text

_STILL_S: Final = 10.0
"""A recording that has not grown for this long, and for three cycles, is no longer written."""

_FIGURES: Final = ("control-caused", "without-help", "unavoidable", "over-delivered", "curtailed")
"""What a list shows of a run: missed, its baseline, and the rest."""

_UNREADABLE: Final[dict[str, Any]] = {
    **dict.fromkeys(("scenario", "scheme", "actuator"), ""),
    **dict.fromkeys(("inverters", "rating_kw"), None),
    "cycle_wall_s": 0.0,
    "faults": [],
}


class _Facts(msgspec.Struct):
    scenario: str = ""
    sim_start: str = ""
    planned_cycles: int = 0
    cycle_s: float = 0.0


class _Summary(msgspec.Struct):
    """What the list shows of a run's summary."""

    run: _Facts = msgspec.field(default_factory=_Facts)
    launcher: LauncherAccount = LauncherAccount()
    cycles: int = 0
    figures: dict[str, float | None] | None = None


def recordings_in(folder: Path) -> dict[str, Path]:
    """Return the recordings in a folder and the folders in it, by the names of their runs.

    A name is a path in the folder, with ~ in place of /.
    """
    patterns = (f"*/{RECORDING_NAME}", f"*/*/{RECORDING_NAME}")
    paths = [path for pattern in patterns for path in folder.glob(pattern)]
    written = {path: stat.st_mtime for path in paths if (stat := _stat(path))}
    paths = sorted(written, key=written.__getitem__, reverse=True)
    return {path.parent.relative_to(folder).as_posix().replace("/", "~"): path for path in paths}


def _stat(path: Path) -> os.stat_result | None:
    """Return what the system says of a file; None: it was deleted meanwhile."""
    with suppress(OSError):
        return path.stat()
    return None


def run_list(folder: Path) -> dict[str, Any]:
    """Return the runs in a folder, the newest first, and the figures that are shown of them."""
    return {
        "folder": str(folder),
        "runs": [
            _row(name, recording, stat)
            for name, recording in recordings_in(folder).items()
            if (stat := _stat(recording))
        ],
    }


def _row(name: str, recording: Path, written: os.stat_result) -> dict[str, Any]:
    summary = None
    with suppress(OSError, msgspec.DecodeError):
        document = (recording.parent / SUMMARY_NAME).read_bytes()
        summary = msgspec.json.decode(document, type=_Summary)
    run = _what_was_run(recording, written.st_ino, written.st_size if summary is None else 0)
    longest_s = max(_STILL_S, 3.0 * run["cycle_wall_s"])
    found = summary or _Summary()
    return {
        "name": name,
        "state": _end(
            recording.parent, summary, is_growing=time.time() - written.st_mtime < longest_s
        ),
        "recorded_ms": written.st_mtime * 1e3,
        "size_mb": written.st_size / 1e6,
        "start": found.run.sim_start,
        "simulated_s": found.cycles * found.run.cycle_s,
        "figures": {figure: (found.figures or {}).get(figure) for figure in _FIGURES},
        **run,
    }


def _end(folder: Path, summary: _Summary | None, *, is_growing: bool) -> str:
    if failure := failure_in(folder):
        return f"failed: {failure}"
    if summary is None:
        return "running" if is_growing else "unfinished"
    launcher, planned = summary.launcher, summary.run.planned_cycles
    covered = f"after {summary.cycles:,} of {planned:,} cycles"
    parts = []
    if launcher.interrupted:
        parts.append(f"interrupted {covered}")
    elif summary.cycles < planned:
        parts.append(f"ended early, {covered}")
    if launcher.given_up:
        parts.append(f"given up: {listed([*launcher.given_up])}")
    if launcher.recording_gaps or launcher.recording_ended:
        parts.append("recording has gaps")
    return "; ".join(parts) or "over"


@lru_cache(1000)
def _what_was_run(recording: Path, file_number: int, size: int) -> dict[str, Any]:
    """Return what a run was planned as; a file of another number is another recording.

    One that has not ended is looked at again when it has grown: it may have had no head yet.
    """
    try:
        with recording.open("rb", buffering=0) as file:
            _, plan = read_origin(read_outline(file), recording)
    except (InputError, OSError) as error:
        return _UNREADABLE | {"unreadable": str(error)}
    return {
        "scenario": plan.plant,
        "scheme": plan.control.scheme,
        "actuator": plan.control.actuator,
        "inverters": len(plan.inverters),
        "rating_kw": plan.tree.rating_kw(ROOT),
        "cycle_wall_s": plan.timing.cycle_wall_ns / 1e9,
        "faults": [fault_text(fault) for fault in plan.faults.rules],
        "unreadable": "",
    }
