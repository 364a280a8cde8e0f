"""The runs in a folder, with their figures."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from recordings.inspect.health import FAILURE_NAME, SUMMARY_NAME
from recordings.read.run_file import RECORDING_NAME
from studies.metrics.figures_of_merit import shown_in


class _Summary(msgspec.Struct):
    """What the list shows of a run's summary."""

    sim_start: str = ""
    cycles: int = 0
    cycle_s: float = 0.0
    figures: dict[str, float | None] = {}


def recordings_in(folder: Path) -> dict[str, Path]:
    """Return the recordings in a folder and the folders in it, by the names of their runs.

    A name is a path in the folder, with ~ in place of /.
    """
    patterns = (f"*/{RECORDING_NAME}", f"*/*/{RECORDING_NAME}")
    found = [path for pattern in patterns for path in folder.glob(pattern)]
    found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    return {path.parent.relative_to(folder).as_posix().replace("/", "~"): path for path in found}


def run_list(folder: Path) -> dict[str, Any]:
    """Return the runs in a folder, the newest first, and the figures that are shown of them."""
    figures = shown_in("compare", "commitment")
    return {
        "folder": str(folder),
        "figures": [{"heading": one.heading, "decimals": one.decimals} for one in figures],
        "runs": [
            _row(name, recording, [figure.name for figure in figures])
            for name, recording in recordings_in(folder).items()
        ],
    }


def _row(name: str, recording: Path, figures: list[str]) -> dict[str, Any]:
    folder, written = recording.parent, recording.stat()
    summary, state = _Summary(), "failed" if (folder / FAILURE_NAME).exists() else ""
    with suppress(OSError, msgspec.DecodeError):
        document = (folder / SUMMARY_NAME).read_bytes()
        summary, state = msgspec.json.decode(document, type=_Summary), "over"
    return {
        "name": name,
        "state": state,
        "recorded_ms": written.st_mtime * 1e3,
        "size_mb": written.st_size / 1e6,
        "start": summary.sim_start,
        "simulated_s": summary.cycles * summary.cycle_s,
        "figures": [summary.figures.get(figure) for figure in figures],
    }
