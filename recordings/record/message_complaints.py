"""What is wrong with messages on the bus: named by key and cause, counted, with an example."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Final

from agents.events import Complaint

ABSURD: Final = "absurd"
"""The cause of complaints about messages of the run whose numbers cannot be right."""

REPEATED: Final = "repeated"
"""The cause of complaints about further messages of a cycle, which are recorded all the same."""

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
        Called with each complaint when it is new, and when it is of another field than before.
    """

    def __init__(self, log: Callable[[str], None], tell: Callable[[Complaint], None]) -> None:
        self._log = log
        self._tell = tell
        self._counts: Counter[tuple[str, str]] = Counter()
        self._examples: dict[tuple[str, str], dict[str, str]] = {}

    def add(self, key: str, cause: str, example: str | Mapping[str, str]) -> None:
        """Complain of a message.

        Parameters
        ----------
        key
            Where it came.
        cause
            In what way it is wrong.
        example
            What is to be said of it; or that by field, where several may be wrong.
        """
        by_field = {"": example} if isinstance(example, str) else example
        self._log(f"{key}: {'; '.join(by_field.values())}")
        place = (key, cause)
        if place not in self._counts and len(self._counts) >= _MOST_NAMED:
            place = (_OTHER_KEYS, cause)
        told = self._examples.setdefault(place, {})
        new = {field: text for field, text in by_field.items() if field not in told}
        if new:
            told |= new
            self._tell(Complaint(*place, 1, "; ".join(new.values())))
        self._counts[place] += 1

    @property
    def set_aside(self) -> int:
        """Messages that were complained of and are not in the recording."""
        return sum(count for (_, cause), count in self._counts.items() if cause not in _RECORDED)

    def all(self) -> tuple[Complaint, ...]:
        """Return each complaint with its count, sorted by key; its examples in one line."""
        return tuple(
            Complaint(key, cause, self._counts[key, cause], "; ".join(told.values()))
            for (key, cause), told in sorted(self._examples.items())
        )
