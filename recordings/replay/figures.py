"""What a replay came to: as lines to be read, and as JSON."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final, TextIO

import msgspec
from hdrh.histogram import HdrHistogram

_LONGEST_NS: Final = 3_600_000_000_000


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


class TimingErrors:
    """How late messages went out, in a histogram of bounded size."""

    def __init__(self) -> None:
        self._histogram = HdrHistogram(1, _LONGEST_NS, 3)

    def add(self, late_ns: int) -> None:
        """Take in one message."""
        self._histogram.record_value(min(max(late_ns, 1), _LONGEST_NS))

    def figures(self) -> TimingFigures | None:
        """Return the distribution, None where nothing had a due time."""
        found = self._histogram
        if not found.get_total_count():
            return None
        p50_us, p99_us, p99_9_us = (
            found.get_value_at_percentile(percent) / 1e3 for percent in (50.0, 99.0, 99.9)
        )
        count, max_us = found.get_total_count(), found.get_max_value() / 1e3
        return TimingFigures(count, p50_us, p99_us, p99_9_us, max_us)


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
