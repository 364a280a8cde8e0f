"""The runs in a folder, as a page lists them: what was run, with which faults, and how it ended."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from bus_schemas.errors import InputError
from bus_schemas.tree import ROOT
from recordings.read.mcap_file import read_outline
from recordings.read.run_file import RECORDING_NAME, SUMMARY_NAME, further_files, read_origin
from results.run_document import Outcome, document_in, failure_in
from scenarios.fault_rules import fault_text

_STILL_S: Final = 10.0
"""A recording that has not grown for this long, and for three cycles, is no longer written."""

_FIGURES: Final = ("control-caused", "without-help", "unavoidable")
"""What a list shows of a run: missed, its baseline, and what the sky denied."""

_UNREADABLE: Final[dict[str, Any]] = {
    **dict.fromkeys(("run_id", "scenario", "scheme"), ""),
    **dict.fromkeys(("inverters", "rating_kw"), None),
    "cycle_wall_s": 0.0,
    "faults": [],
}


def recordings_in(folder: Path) -> dict[str, Path]:
    """Return the recordings in a folder and the folders in it, by the names of their runs.

    A name is a path in the folder, with ~ in place of /.
    """
    patterns = (f"*/{RECORDING_NAME}", f"*/*/{RECORDING_NAME}")
    paths = [path for pattern in patterns for path in folder.glob(pattern)]
    written = {path: _written_at(path) for path in paths if _stat(path)}
    paths = sorted(written, key=written.__getitem__, reverse=True)
    return {path.parent.relative_to(folder).as_posix().replace("/", "~"): path for path in paths}


def _stat(path: Path) -> os.stat_result | None:
    """Return what the system says of a file; None: it was deleted meanwhile."""
    with suppress(OSError):
        return path.stat()
    return None


def _written_at(recording: Path) -> float:
    """Return when a recording grew last, in the first or a further file."""
    files = (recording, *(path for _, path in further_files(recording)))
    return max((stat.st_mtime for path in files if (stat := _stat(path))), default=0.0)


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
    folder = recording.parent
    has_ended = (folder / SUMMARY_NAME).exists()
    run = _what_was_run(recording, written.st_ino, 0 if has_ended else written.st_size)
    found, why_not = document_in(folder, run["run_id"])
    outcome = Outcome(found, failure_in(folder), undocumented=why_not)
    longest_s = max(_STILL_S, 3.0 * run["cycle_wall_s"])
    written_at = _written_at(recording)
    is_growing = time.time() - written_at < longest_s
    return {
        "name": name,
        "state": _end(outcome, is_growing=is_growing, has_ended=has_ended),
        "recorded_ms": written_at * 1e3,
        "start": found.sim_start if found else "",
        "simulated_s": found.cycles * found.cycle_s if found else 0.0,
        "figures": {
            figure: found.figures.get(figure) if found and found.figures else None
            for figure in _FIGURES
        },
        **run,
    }


def _end(outcome: Outcome, *, is_growing: bool, has_ended: bool) -> str:
    if outcome.document is None and not outcome.failure:
        if has_ended:
            return outcome.undocumented
        return "running" if is_growing else "unfinished"
    return outcome.text


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
        "run_id": plan.run_id,
        "scenario": plan.plant,
        "scheme": plan.control.scheme,
        "inverters": len(plan.inverters),
        "rating_kw": plan.tree.rating_kw(ROOT),
        "cycle_wall_s": plan.timing.cycle_wall_ns / 1e9,
        "faults": [fault_text(fault) for fault in plan.faults.rules],
        "unreadable": "",
    }
