"""What happened in a run, as a list that the page shows."""

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import Final

import msgspec

_KEPT: Final = 500
_MERGED: Final = 40
"""An event like one of the last ones is counted with it."""

_MERGED_CYCLES: Final = 60


class Event(msgspec.Struct):
    """Something that happened, once or `count` times from `cycle` to `last_cycle`.

    `revision` grows whenever an event is new or has changed.
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
    """The newest events of a run."""

    def __init__(self) -> None:
        self.revision = 0
        self._events: deque[Event] = deque(maxlen=_KEPT)
        self._number = 0

    def add(self, kind: str, cycle: int, agent: str, text: str, count: int = 1) -> None:
        """Enter an event; one of the same kind, agent and text shortly before is counted on."""
        self.revision += 1
        for event in islice(reversed(self._events), _MERGED):
            same = (event.kind, event.agent, event.text) == (kind, agent, text)
            if same and cycle <= event.last_cycle + _MERGED_CYCLES:
                event.count += count
                event.last_cycle = max(cycle, event.last_cycle)
                event.revision = self.revision
                return
        self._number += 1
        self._events.append(
            Event(self._number, self.revision, kind, cycle, cycle, agent, text, count)
        )

    def since(self, revision: int) -> list[Event]:
        """Return the events that are newer than a revision, or have changed since."""
        return [event for event in self._events if event.revision > revision]
