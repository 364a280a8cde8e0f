"""What is told of each tier besides durations: its counts, its processor time, its memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from launch_scripts.timing.measures import TierAccount


class TierColumn(NamedTuple):
    """A figure of a tier.

    Attributes
    ----------
    name, unit
        What it is, and its unit; empty of a count.
    heading, width
        The same in two short lines, for a terminal, and how many characters the column has.
    text
        Writes it.
    """

    name: str
    unit: str
    heading: str
    width: int
    text: Callable[[TierAccount], str]


_OF_A_CORE: Final = "% of a core"

TIER_COLUMNS: Final = (
    TierColumn("Processes", "", "processes", 9, lambda tier: f"{tier.processes}"),
    TierColumn(
        "Missed deadlines", "", "missed\ndeadlines", 9, lambda tier: f"{tier.missed_deadlines:,}"
    ),
    TierColumn("Missing inputs", "", "missing\ninputs", 7, lambda tier: f"{tier.missing_inputs:,}"),
    TierColumn("Late words used", "", "late\nused", 6, lambda tier: f"{tier.late_used:,}"),
    TierColumn("Dropped messages", "", "dropped", 7, lambda tier: f"{tier.dropped:,}"),
    TierColumn("Overruns", "", "overruns", 8, lambda tier: f"{tier.overruns:,}"),
    TierColumn("Cycles given up", "", "given\nup", 6, lambda tier: f"{tier.cycles_given_up:,}"),
    TierColumn(
        "Processor time, all", _OF_A_CORE, "CPU [%]\nall", 7, lambda tier: f"{tier.cpu_percent:.1f}"
    ),
    TierColumn(
        "Processor time, highest",
        _OF_A_CORE,
        "CPU [%]\nhighest",
        8,
        lambda tier: f"{tier.cpu_highest_percent:.1f}",
    ),
    TierColumn("Memory, largest", "MB", "memory\n[MB]", 7, lambda tier: f"{tier.resident_mb:.1f}"),
)
