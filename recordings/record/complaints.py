"""What is wrong with messages on the bus: counted by key and cause, with the first example."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from msgspec.structs import replace

from agents.inputs import log_drop
from agents.process.events import Complaint
from bus_schemas.errors import printable

# Causes of complaints about messages that are recorded: numbers that cannot be right, messages that
# came again, and messages that contradict others of their key.
OUT_OF_RANGE: Final = "out_of_range"
DUPLICATE: Final = "duplicate"
CONFLICTING: Final = "conflicting"
# Others are set aside.
WRONG_CYCLE: Final = "wrong_cycle"
WRONG_SENDER: Final = "wrong_sender"
UNDECODABLE: Final = "undecodable"
UNKNOWN: Final = "unknown"

_RECORDED: Final = frozenset({OUT_OF_RANGE, DUPLICATE, CONFLICTING})

_MOST_KINDS: Final = 500
_MOST_UNKNOWN: Final = 5
"""Keys and causes that are counted apart, and among them keys that a stranger has invented."""

_LONGEST: Final = 300
"""Characters of a key or an example that are kept."""


class Complaints:
    """All complaints of a run."""

    def __init__(self, tell: Callable[[Complaint], None]) -> None:
        self._tell = tell
        self._by_kind: dict[tuple[str, str], Complaint] = {}

    def add(self, key: str, cause: str, example: str) -> None:
        """Count a wrong message."""
        key, example = printable(key[:_LONGEST]), printable(example[:_LONGEST])
        if (key, cause) not in self._by_kind:
            unknown = sum(one == UNKNOWN for _, one in self._by_kind)
            is_one_more = cause == UNKNOWN and unknown >= _MOST_UNKNOWN
            if is_one_more or len(self._by_kind) >= _MOST_KINDS:
                key = "other keys"
        before = self._by_kind.get((key, cause))
        if before is None:
            complaint = Complaint(key, cause, 1, example)
            self._tell(complaint)
        else:
            complaint = replace(before, count=before.count + 1)
        self._by_kind[key, cause] = complaint
        log_drop(complaint.count, f"{key}: {example}")

    @property
    def set_aside(self) -> int:
        """Wrong messages that are not in the recording."""
        return sum(one.count for one in self._by_kind.values() if one.cause not in _RECORDED)

    def all(self) -> tuple[Complaint, ...]:
        """Return each complaint with its count, sorted by key."""
        return tuple(self._by_kind[kind] for kind in sorted(self._by_kind))
