"""What is wrong with messages on the bus: named by key and cause, counted, with an example."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final

from agents.events import Complaint
from recordings.recordable_messages import REPEATED

ABSURD: Final = "absurd"
"""The cause of complaints about messages of the run whose numbers cannot be right."""

_RECORDED: Final = frozenset({ABSURD, REPEATED})
"""Causes of complaints about messages that are in the recording."""

_MOST_NAMED: Final = 200
"""A device that makes up keys must not fill the memory: beyond this they are counted together."""

_OTHER_KEYS: Final = "other keys"


class Complaints:
    """All complaints of a run.

    Parameters
    ----------
    log
        Called with a line of text for each message that is complained of.
    tell
        Called with each complaint when it is new.

    """

    def __init__(self, log: Callable[[str], None], tell: Callable[[Complaint], None]) -> None:
        self._log = log
        self._tell = tell
        self._counts: Counter[tuple[str, str]] = Counter()
        self._examples: dict[tuple[str, str], str] = {}

    def add(self, key: str, cause: str, example: str) -> None:
        """Complain of a message."""
        self._log(f"{key}: {example}")
        place = (key, cause)
        if place not in self._counts and len(self._counts) >= _MOST_NAMED:
            place = (_OTHER_KEYS, cause)
        if place not in self._examples:
            self._examples[place] = example
            self._tell(Complaint(*place, 1, example))
        self._counts[place] += 1

    @property
    def set_aside(self) -> int:
        """Messages that were complained of and are not in the recording."""
        return sum(count for (_, cause), count in self._counts.items() if cause not in _RECORDED)

    def all(self) -> tuple[Complaint, ...]:
        """Return each complaint with its count, sorted by key."""
        return tuple(
            Complaint(key, cause, self._counts[key, cause], example)
            for (key, cause), example in sorted(self._examples.items())
        )
