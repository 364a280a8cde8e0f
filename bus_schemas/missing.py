"""What the entries of a message's `missing` say: which messages its sender decided on.

`c2/inv07/impp@41`: the newest message was that of cycle 41. `c2/inv07/impp`: there was none, or it
was too old to count. For an input without an entry the sender used the message that was due.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final, NamedTuple

_CYCLE: Final = re.compile(r"0|[1-9][0-9]{0,17}")


class Missing(NamedTuple):
    """An entry taken apart. `cycle` is that of the message used; None if there was none."""

    key: str
    cycle: int | None

    def __str__(self) -> str:
        return self.key if self.cycle is None else f"{self.key}@{self.cycle}"


def parse_missing(entry: str) -> Missing:
    """Take an entry apart. An entry without a valid cycle is a key as a whole."""
    key, at, cycle = entry.rpartition("@")
    return Missing(key, int(cycle)) if at and _CYCLE.fullmatch(cycle) else Missing(entry, None)


def in_words(missing: Iterable[str]) -> str:
    """Say what a decision was based on: `without c1/impp, used c2/impp of cycle 41`."""
    return ", ".join(
        f"without {key}" if used is None else f"used {key} of cycle {used:,}"
        for key, used in map(parse_missing, missing)
    )
