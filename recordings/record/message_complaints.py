"""What is wrong with messages on the bus: counted by key and cause, with the first example."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final

from agents.events import Complaint
from bus_schemas.printable import printable

ABSURD: Final = "absurd"
"""The cause of complaints about messages of the run whose numbers cannot be right."""

REPEATED: Final = "repeated"
"""The cause of complaints about messages that came again, which are recorded all the same."""

TWO_SENDERS: Final = "two senders"
"""The cause of complaints about messages that contradict others of their key. They are recorded."""

_RECORDED: Final = frozenset({ABSURD, REPEATED, TWO_SENDERS})

_MOST_PLACES: Final = 500
"""Keys and causes that are told apart: somebody may invent keys without end."""

_LONGEST: Final = 300
"""Characters of a key or an example that are kept."""


class Complaints:
    """All complaints of a run."""

    def __init__(self, log: Callable[[str], None], tell: Callable[[Complaint], None]) -> None:
        self._log = log
        self._tell = tell
        self._counts: Counter[tuple[str, str]] = Counter()
        self._examples: dict[tuple[str, str], str] = {}

    def add(self, key: str, cause: str, example: str) -> None:
        key, example = printable(key[:_LONGEST]), printable(example[:_LONGEST])
        self._log(f"{key}: {example}")
        place = (key, cause)
        if place not in self._counts and len(self._counts) >= _MOST_PLACES:
            place = ("other keys", cause)
        self._counts[place] += 1
        if place not in self._examples:
            self._examples[place] = example
            self._tell(Complaint(*place, 1, example))

    @property
    def set_aside(self) -> int:
        """Wrong messages that are not in the recording."""
        return sum(n for (_, cause), n in self._counts.items() if cause not in _RECORDED)

    def all(self) -> tuple[Complaint, ...]:
        """Return each complaint with its count, sorted by key."""
        return tuple(
            Complaint(*place, self._counts[place], example)
            for place, example in sorted(self._examples.items())
        )
