"""What the entries of a message's `missing` say: how its sender came by its inputs.

An entry is the key of an input, without the plant's name: `c1/inv07/impp` did not come in time, and
nothing took its place. With a cycle, `c1/inv07/impp@41`, the late word of cycle 41 took its place.
`skipped@41` is no input: the sender had fallen behind, and gave up its own cycles from 41 on, up to
the one before the message's; or the message's own, where it names that one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final, NamedTuple

SKIPPED: Final = "skipped"
"""Stands in the place of a key for an agent's own cycles."""

_CYCLE: Final = re.compile(r"0|[1-9][0-9]{0,17}")
"""A cycle as it is written: below 10^18, as cycles are."""


class Absence(NamedTuple):
    """An entry taken apart.

    Attributes
    ----------
    key
        Key of the input, or `SKIPPED`.
    cycle
        Cycle of the late word that was used, or the first one that was skipped. None: nothing took
        the input's place.
    """

    key: str
    cycle: int | None

    def __str__(self) -> str:
        return self.key if self.cycle is None else f"{self.key}@{self.cycle}"


def absence(entry: str) -> Absence:
    """Take an entry apart. What ends in no cycle is a key as a whole.

    A device may write anything: each entry, put together again, is what it was.
    """
    key, at, cycle = entry.rpartition("@")
    return Absence(key, int(cycle)) if at and _CYCLE.fullmatch(cycle) else Absence(entry, None)


def skipped_cycles(missing: Iterable[str], cycle: int) -> range:
    """Return the cycles that the sender of a message of this cycle says it gave up."""
    for entry in missing:
        if entry.startswith(SKIPPED):
            key, first = absence(entry)
            if key == SKIPPED and first is not None and first <= cycle:
                return range(first, max(first + 1, cycle))
    return range(0)


def in_words(missing: Iterable[str], cycle: int) -> str:
    """Say how the sender of a message of this cycle came by its inputs, as far as it is special.

    For instance `without c1/impp; used c2/impp of cycle 41`. Empty: it had all of them.
    """
    missing = tuple(missing)
    inputs = [entry for entry in map(absence, missing) if not _tells_of_own_cycles(entry)]
    skipped = skipped_cycles(missing, cycle)
    without = [key for key, used in inputs if used is None]
    late = [f"{key} of cycle {used:,}" for key, used in inputs if used is not None]
    parts = []
    if skipped:
        parts.append(_skipped_in_words(skipped))
    if without:
        parts.append("without " + ", ".join(without))
    if late:
        parts.append("used " + ", ".join(late))
    return "; ".join(parts)


def _tells_of_own_cycles(entry: Absence) -> bool:
    return entry.key == SKIPPED and entry.cycle is not None


def _skipped_in_words(skipped: range) -> str:
    if len(skipped) == 1:
        return f"skipped cycle {skipped[0]:,}"
    return f"skipped cycles {skipped[0]:,} to {skipped[-1]:,}"
