"""What is wrong with messages on the bus: counted by key and cause, with the first example."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final

from agents.events import Complaint

ABSURD: Final = "absurd"
"""The cause of complaints about messages of the run whose numbers cannot be right."""

REPEATED: Final = "repeated"
"""The cause of complaints about further messages of a cycle, which are recorded all the same."""


class Complaints:
    """All complaints of a run."""

    def __init__(self, log: Callable[[str], None], tell: Callable[[Complaint], None]) -> None:
        self._log = log
        self._tell = tell
        self._counts: Counter[tuple[str, str]] = Counter()
        self._examples: dict[tuple[str, str], str] = {}

    def add(self, key: str, cause: str, example: str) -> None:
        """Complain of a message on a key."""
        self._log(f"{key}: {example}")
        place = (key, cause)
        self._counts[place] += 1
        if place not in self._examples:
            self._examples[place] = example
            self._tell(Complaint(key, cause, 1, example))

    @property
    def set_aside(self) -> int:
        """Wrong messages that are not in the recording."""
        return sum(n for (_, cause), n in self._counts.items() if cause not in {ABSURD, REPEATED})

    def all(self) -> tuple[Complaint, ...]:
        """Return each complaint with its count, sorted by key."""
        return tuple(
            Complaint(*place, self._counts[place], example)
            for place, example in sorted(self._examples.items())
        )
