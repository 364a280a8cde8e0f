"""What is wrong with messages on the bus: counted by key and cause, with the first example."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from msgspec.structs import replace

from agents.events import Complaint
from bus_schemas.printable import printable

# Causes of complaints: numbers that cannot be right, messages that came again, and messages that
# contradict others of their key. All of them are recorded.
ABSURD: Final = "absurd"
REPEATED: Final = "repeated"
TWO_SENDERS: Final = "two senders"

_RECORDED: Final = frozenset({ABSURD, REPEATED, TWO_SENDERS})

_MOST_PLACES: Final = 500
"""Keys and causes that are told apart: somebody may invent keys without end."""

_LONGEST: Final = 300
"""Characters of a key or an example that are kept."""


class Complaints:
    """All complaints of a run."""

    def __init__(self, log: Callable[[int, str], None], tell: Callable[[Complaint], None]) -> None:
        self._log = log
        self._tell = tell
        self._found: dict[tuple[str, str], Complaint] = {}

    def add(self, key: str, cause: str, example: str) -> None:
        key, example = printable(key[:_LONGEST]), printable(example[:_LONGEST])
        if (key, cause) not in self._found and len(self._found) >= _MOST_PLACES:
            key = "other keys"
        before = self._found.get((key, cause))
        if before is None:
            found = Complaint(key, cause, 1, example)
            self._tell(found)
        else:
            found = replace(before, count=before.count + 1)
        self._found[key, cause] = found
        self._log(found.count, f"{key}: {example}")

    @property
    def set_aside(self) -> int:
        """Wrong messages that are not in the recording."""
        return sum(one.count for one in self._found.values() if one.cause not in _RECORDED)

    def all(self) -> tuple[Complaint, ...]:
        """Return each complaint with its count, sorted by key."""
        return tuple(self._found[place] for place in sorted(self._found))
