"""The runs in a folder, as a page lists them: what was run, with which faults, and how it ended."""

from __future__ import annotations

import time
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import msgspec

from bus_schemas.errors import InputError, listed
from recordings.inspect.health import SUMMARY_NAME, LauncherAccount, failure_in
from recordings.read.mcap_file import read_outline
from recordings.read.run_file import RECORDING_NAME, read_origin
from results.figures import Shown, shown_in
from scenarios.fault_rules import fault_text

_STILL_S: Final = 10.0
"""A recording that has grown since so long ago is still being written."""


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
    paths.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    return {path.parent.relative_to(folder).as_posix().replace("/", "~"): path for path in paths}


def run_list(folder: Path) -> dict[str, Any]:
    """Return the runs in a folder, the newest first, and the figures that are shown of them."""
    figures = shown_in(Shown.COMPARE, Shown(0))
    return {
        "folder": str(folder),
        "figures": [{"heading": one.heading, "decimals": one.decimals} for one in figures],
        "runs": [
            _row(name, recording, [figure.name for figure in figures])
            for name, recording in recordings_in(folder).items()
        ],
    }


def _row(name: str, recording: Path, figures: list[str]) -> dict[str, Any]:
    written = recording.stat()
    summary = None
    with suppress(OSError, msgspec.DecodeError):
        document = (recording.parent / SUMMARY_NAME).read_bytes()
        summary = msgspec.json.decode(document, type=_Summary)
    is_growing = time.time() - written.st_mtime < _STILL_S
    found = summary or _Summary()
    return {
        "name": name,
        "state": _end(recording.parent, summary, is_growing=is_growing),
        "recorded_ms": written.st_mtime * 1e3,
        "size_mb": written.st_size / 1e6,
        "start": found.run.sim_start,
        "simulated_s": found.cycles * found.run.cycle_s,
        "figures": [(found.figures or {}).get(figure) for figure in figures],
        **_what_was_run(recording, written.st_ino),
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
def _what_was_run(recording: Path, file_number: int) -> dict[str, Any]:
    """Return scheme, actuator and faults; a file of another number is another recording."""
    try:
        with recording.open("rb", buffering=0) as file:
            _, plan = read_origin(read_outline(file), recording)
    except (InputError, OSError) as error:
        return {
            "scenario": "",
            "scheme": "",
            "actuator": "",
            "faults": [],
            "unreadable": str(error),
        }
    return {
        "scenario": plan.plant,
        "scheme": plan.control.scheme,
        "actuator": plan.control.actuator,
        "faults": [fault_text(fault) for fault in plan.faults.rules],
        "unreadable": "",
    }
