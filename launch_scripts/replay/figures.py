"""What a replay came to: as lines to be read, and as JSON."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TextIO

import msgspec
from hdrh.histogram import HdrHistogram

from launch_scripts.timing.distributions import distribution


class TimingFigures(msgspec.Struct, frozen=True):
    """Sent less due, over all messages that had a due time [µs]."""

    count: int
    p50_us: float
    p99_us: float
    p99_9_us: float
    max_us: float


class ReplayFigures(msgspec.Struct, frozen=True):
    """What a replay came to."""

    run_id: str
    recording: str
    messages: int
    cycles: int
    wall_s: float
    rate: float
    clock: str
    timing_error: TimingFigures | None
    interrupted: bool


def timing_figures(timing: HdrHistogram) -> TimingFigures | None:
    """Return the distribution of timing errors, None where nothing had a due time."""
    found = distribution(timing)
    if found is None:
        return None
    return TimingFigures(
        found.count, found.p50_us, found.p99_us, p99_9_us=found.p99_9_us, max_us=found.max_us
    )


def print_replay(figures: ReplayFigures, out: TextIO) -> None:
    """Print what a replay came to."""
    out.write(
        f"replayed {figures.messages:,} messages of {figures.cycles:,} cycles in "
        f"{figures.wall_s:.1f} s\n"
    )
    print_timing(figures.timing_error, out)


def print_timing(timing: TimingFigures | None, out: TextIO) -> None:
    """Print the distribution of timing errors, if there is one."""
    if timing is not None:
        out.write(
            f"timing error, sent less due: p50 {timing.p50_us:,.0f} µs, p99 {timing.p99_us:,.0f} "
            f"µs, p99.9 {timing.p99_9_us:,.0f} µs, max {timing.max_us:,.0f} µs\n"
        )
    out.flush()


def write_json(figures: msgspec.Struct, json: str | None) -> None:
    """Write figures to a file, or to standard output (`-`), if they are wanted."""
    if json is None:
        return
    document = msgspec.json.format(msgspec.json.encode(figures), indent=1)
    if json == "-":
        sys.stdout.write(document.decode() + "\n")
    else:
        Path(json).write_bytes(document + b"\n")
