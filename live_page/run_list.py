"""The runs in a folder, with their figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from bus_schemas.errors import InputError
from recordings.inspect.health import FAILURE_NAME, SUMMARY_NAME
from recordings.read.run_file import RECORDING_NAME
from studies.metrics.figures_of_merit import shown_in


class _Summary(msgspec.Struct):
    """What the list shows of a run's summary."""

    sim_start: str = ""
    cycles: int = 0
    cycle_s: float = 0.0
    wall_s: float = 0.0
    figures: dict[str, float | None] = {}


class RunList:
    """The runs in a folder and the folders in it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def recordings(self) -> dict[str, Path]:
        """Return the recordings by the names of their runs: their paths, with ~ in place of /."""
        patterns = (f"*/{RECORDING_NAME}", f"*/*/{RECORDING_NAME}")
        found = [path for pattern in patterns for path in self._folder.glob(pattern)]
        found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        names = (path.parent.relative_to(self._folder).as_posix() for path in found)
        return dict(zip((name.replace("/", "~") for name in names), found, strict=True))

    def path(self, name: str) -> Path:
        found = self.recordings().get(name)
        if found is None:
            raise InputError(f"{name}: no run of that name in {self._folder}")
        return found.parent

    def rows(self) -> dict[str, Any]:
        """Return the runs, the newest first, and the figures that are shown of them."""
        figures = shown_in("compare", "commitment")
        return {
            "folder": str(self._folder),
            "figures": [{"heading": one.heading, "decimals": one.decimals} for one in figures],
            "runs": [
                self._row(name, recording, [figure.name for figure in figures])
                for name, recording in self.recordings().items()
            ],
        }

    def _row(self, name: str, recording: Path, figures: list[str]) -> dict[str, Any]:
        folder, written = recording.parent, recording.stat()
        try:
            summary = msgspec.json.decode((folder / SUMMARY_NAME).read_bytes(), type=_Summary)
        except (OSError, msgspec.DecodeError):
            summary = None
        return {
            "name": name,
            "state": "over" if summary else "failed" if (folder / FAILURE_NAME).exists() else "",
            "recorded_ms": written.st_mtime * 1e3,
            "size_mb": written.st_size / 1e6,
            "start": summary.sim_start if summary else "",
            "simulated_s": summary.cycles * summary.cycle_s if summary else None,
            "figures": [summary.figures.get(figure) if summary else None for figure in figures],
        }
