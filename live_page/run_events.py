"""What happened in a run, as a list that the page shows."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Final, TypeAlias

import msgspec

from recordings.inspect.agent_states import Change

_MOST: Final = 500
_MERGED_CYCLES: Final = 60
"""Repetitions within this many cycles are one event with a count."""

Subject: TypeAlias = tuple[str, str, str]
"""Kind, agent and text of events."""


class Event(msgspec.Struct):
    """Something that happened, once or `count` times from `cycle` to `last_cycle`.

    `revision` grows whenever an event is new or has changed; its count is 0 once it turns out not
    to have happened.
    """

    number: int
    revision: int
    kind: str
    cycle: int
    last_cycle: int
    agent: str
    text: str
    count: int


class RunEvents:
    """The events of a run. What is known of them may change, since messages can come late."""

    def __init__(self) -> None:
        self.revision = 0
        self._times = defaultdict[Subject, Counter[int]](Counter)
        self._changes: set[Change] = set()
        self._unwritten: set[Subject] = set()
        self._events = defaultdict[Subject, dict[int, Event]](dict)
        self._count = 0

    def add(self, kind: str, cycle: int, agent: str, text: str, count: int = 1) -> None:
        subject = kind, agent, text
        self._times[subject][cycle] += count
        self._unwritten.add(subject)

    def replace(self, changes: Iterable[Change]) -> None:
        """Let these changes take the place of those that were given before."""
        new = set(changes)
        for change in self._changes - new:
            self.add(*change, count=-1)
        for change in new - self._changes:
            self.add(*change)
        self._changes = new

    def since(self, revision: int) -> list[Event]:
        """Return the newest events of those that are newer than a revision, or have changed."""
        for subject in self._unwritten:
            self._write(subject)
        self._unwritten.clear()
        events = chain.from_iterable(one.values() for one in self._events.values())
        found = [event for event in events if event.revision > revision]
        return sorted(found, key=lambda event: (event.cycle, event.number))[-_MOST:]

    def _write(self, subject: Subject) -> None:
        """Bring the events of a subject up to date."""
        groups = {first: (last, count) for first, last, count in _groups(+self._times[subject])}
        events = self._events[subject]
        for event in events.values():
            last, count = groups.pop(event.cycle, (event.cycle, 0))
            if (event.last_cycle, event.count) != (last, count):
                self.revision += 1
                event.last_cycle, event.count, event.revision = last, count, self.revision
        kind, agent, text = subject
        for first, (last, count) in groups.items():
            self.revision += 1
            self._count += 1
            events[first] = Event(self._count, self.revision, kind, first, last, agent, text, count)


def _groups(times: Counter[int]) -> Iterator[tuple[int, int, int]]:
    """Yield first and last cycle and count of what happened again and again."""
    first, last, count = -1, -1, 0
    for cycle in sorted(times):
        if count and cycle > last + _MERGED_CYCLES:
            yield first, last, count
            count = 0
        first, last, count = first if count else cycle, cycle, count + times[cycle]
    if count:
        yield first, last, count
