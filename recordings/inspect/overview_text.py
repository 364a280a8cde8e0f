"""An overview as lines of text that fit a terminal of 80 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from typing import Final

from recordings.inspect.health import health_lines
from recordings.inspect.overview import Overview, SignalCount
from recordings.read.run_clock import RunClock

_NAME_WIDTH: Final = 11
_SHOWN_GAPS: Final = 10
_COLUMNS: Final = (
    ("", "signal", 11),
    ("", "nodes", 5),
    ("", "messages", 11),
    ("per", "cycle", 8),
    ("per", "s", 9),
    ("", "lost", 7),
    ("", "repeated", 8),
    ("cycles", "without", 8),
)
"""Two lines of heading and the width of each column of the table of signals."""


def overview_lines(overview: Overview, clock: RunClock, width: int) -> Iterator[str]:
    """Yield the lines of an overview: facts, the table of signals, health, gaps."""
    yield from _named(_facts(overview), width)
    yield ""
    yield _row([name for name, _, _ in _COLUMNS]).rstrip()
    yield _row([name for _, name, _ in _COLUMNS])
    yield from (_row(_cells(count)) for count in overview.signals)
    yield ""
    yield "health"
    yield from _named(health_lines(overview.health, clock), width)
    if overview.gaps:
        yield ""
        yield "cycles without a message that was due"
    for gap in overview.gaps[:_SHOWN_GAPS]:
        begin, end = clock.text(gap.first_cycle), clock.text(gap.last_cycle)
        yield (
            f"{gap.port}: {gap.cycles:,} from {gap.first_cycle:,} to {gap.last_cycle:,} "
            f"({begin} to {end})"
        )
    rest = len(overview.gaps) - _SHOWN_GAPS + overview.more_gaps
    if rest > 0:
        yield f"and {rest:,} more gaps (--json has the first 100)"


def _named(facts: Iterable[tuple[str, str]], width: int) -> Iterator[str]:
    """Put names before texts, each once, and wrap the texts."""
    last = ""
    for name, value in facts:
        lines = textwrap.wrap(value, width - _NAME_WIDTH, break_long_words=False) or [""]
        lines[0] = ("" if name == last else name).ljust(_NAME_WIDTH) + lines[0]
        last = name
        yield from (lines[0], *(" " * _NAME_WIDTH + line for line in lines[1:]))


def _row(cells: Iterable[str]) -> str:
    first, *rest = zip(cells, (width for _, _, width in _COLUMNS), strict=True)
    return " ".join([first[0].ljust(first[1]), *(cell.rjust(width) for cell, width in rest)])


def _cells(count: SignalCount) -> list[str]:
    return [
        count.signal,
        f"{count.nodes:,}",
        f"{count.messages:,}",
        f"{count.per_cycle:,.2f}",
        f"{count.per_s:,.1f}",
        f"{count.lost:,}",
        f"{count.repeated:,}",
        f"{count.missing_cycles:,}",
    ]


def _facts(overview: Overview) -> Iterator[tuple[str, str]]:
    chunks = f"{overview.chunks:,} chunk{'s' if overview.chunks != 1 else ''}"
    yield "recording", f"{overview.path} ({overview.size_mb:,.1f} MB, {chunks})"
    yield "scenario", overview.title or overview.plant
    yield "run", f"{overview.run_id}, heliarch {overview.driver}"
    pace = "lockstep" if overview.lockstep else f"pace {overview.pace:g}"
    yield "control", f"scheme {overview.scheme}, actuator {overview.actuator}, {pace}"
    begin, end = (text.replace("T", " ")[:19] for text in (overview.start, overview.end))
    yield "time", f"{begin} to {end}, {overview.timezone}"
    yield (
        "cycles",
        f"{overview.first_cycle:,} to {overview.last_cycle:,} of {overview.cycle_s:g} s, "
        f"{overview.complete_cycles:,} complete, {overview.planned_cycles:,} planned",
    )
    yield "duration", f"{overview.simulated_s:,.0f} s simulated in {overview.wall_s:,.1f} s"
    origin = overview.origin
    versions = [f"{name} {text}" for name, text in overview.versions.items()]
    yield "versions", ", ".join([*versions, f"Python {origin.get('python', 'not stated')}"])
    if "host" in origin:  # A run in memory does not depend on it.
        cpus, kernel = origin.get("cpu_count", "?"), origin.get("kernel", "?")
        yield "host", f"{origin['host']}, {cpus} CPUs, Linux {kernel}"
    files = f", {overview.files} files: its recorder was restarted" if overview.files > 1 else ""
    yield "file", f"{'whole' if overview.whole else 'cut'}{files}{_recovered(overview)}"


def _recovered(overview: Overview) -> str:
    """Say that a file was recovered, and whether anything may be missing in it."""
    if not overview.recovery:
        return ""
    lossless = overview.recovery.get("lossless") == "true"
    return (
        f", recovered from {overview.recovery.get('recovered_from', 'another file')}, "
        f"{'nothing' if lossless else 'something'} is missing"
    )
