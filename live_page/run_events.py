"""What happened in a run, as a list that the page shows."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import Final

import msgspec

from recordings.inspect.agent_states import Change

_MOST: Final = 500
_MERGED_CYCLES: Final = 60
"""Repetitions within this many cycles are one event with a count."""


class Event(msgspec.Struct, frozen=True):
    """Something that happened, once or `count` times from `cycle` on."""

    kind: str
    cycle: int
    agent: str
    text: str
    count: int


def events_of(changes: Iterable[Change]) -> list[Event]:
    """Return what happened in the order of time, of much the newest."""
    times = defaultdict[tuple[str, str, str], list[int]](list)
    for kind, cycle, agent, text in changes:
        times[kind, agent, text].append(cycle)
    found = [
        Event(kind, first, agent, text, count)
        for (kind, agent, text), cycles in times.items()
        for first, count in _merged(sorted(cycles))
    ]
    return sorted(found, key=lambda event: event.cycle)[-_MOST:]


def _merged(cycles: Iterable[int]) -> Iterable[tuple[int, int]]:
    """Return the first cycle and the count of what happened again and again."""
    counts: dict[int, int] = {}
    first = last = -1
    for cycle in cycles:
        if not counts or cycle > last + _MERGED_CYCLES:
            first = cycle
        counts[first] = counts.get(first, 0) + 1
        last = cycle
    return counts.items()
