"""Runs `heliarch launch` and reads what its summary says."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from math import nan
from pathlib import Path
from typing import Any

import msgspec
from outside import Failure, Watched, run


class Launch(msgspec.Struct, frozen=True, kw_only=True):
    """One launch in lockstep. Memory is that of the median direct controller [MB], NaN if unknown.

    A launcher looks at its processes one after another: in a short run it may not come round.

    `startup_s` is the time from the command to cycle 0. `processor_ms` is the processor time of all
    processes for each cycle, seen from outside: see `outside.Watched`.
    """

    cycles: int
    cycles_per_s: float
    startup_s: float
    processor_ms: float
    processes: int
    messages: int
    lost: int
    resident_mb: float
    own_mb: float


def launch(
    heliarch: Path,
    scenario: str,
    cycles: int,
    keep: Path | None = None,
    words: Sequence[str] = (),
) -> Launch:
    """Launch a scenario at full pace, recorded, in a folder that is thrown away unless kept.

    `words` are further options.

    The scenarios that come with the project have cycles of one second.

    Raises
    ------
    Failure
        It failed, took too long, or wrote no summary.
    """
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        summary = Path(folder) / "summary.json"
        out = keep or Path(folder) / "run"
        command = [
            str(heliarch),
            "launch",
            scenario,
            "--pace",
            "max",
            "--duration",
            f"{cycles}s",
            *words,
        ]
        watched = run([*command, "--out", str(out), "--json", str(summary)])
        if not summary.exists():
            raise Failure(f"{heliarch} wrote no summary:\n{watched.output}")
        return _read(msgspec.json.decode(summary.read_bytes()), watched)


def _read(summary: dict[str, Any], watched: Watched) -> Launch:
    """Take the figures out of a summary: the one place that knows its names."""
    # A run may be over before anybody has looked at its memory.
    of_direct = (each for each in summary["memory"] if each["kind"] == "direct")
    memory: dict[str, Any] = next(of_direct, {})
    began = watched.started + summary["startup_s"]
    ended = began + summary["wall_s"]
    return Launch(
        cycles=summary["cycles"],
        cycles_per_s=summary["cycles_per_s"],
        startup_s=summary["startup_s"],
        processor_ms=watched.processor_ms(began, ended, summary["cycles"]),
        processes=watched.processes,
        messages=sum(each["published"] for each in summary["messages"]),
        lost=summary["messages_lost"],
        resident_mb=memory.get("resident_median_mb") or nan,
        own_mb=memory.get("own_median_mb") or nan,
    )
