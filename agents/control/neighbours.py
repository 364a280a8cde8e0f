"""Step 3: virtual neighbours, the order in which a child in need asks its siblings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

HelpOrder: TypeAlias = tuple[tuple[int, ...], ...]
"""For each child the positions of its siblings, the one to ask first at the front."""


def help_order(correlation: Sequence[Sequence[float]]) -> HelpOrder:
    """Order each child's siblings by ascending correlation with it (eq. 5).

    Equal correlations keep the order of the children, so that the result is one and the same
    everywhere.

    Parameters
    ----------
    correlation
        Pearson correlation between the children's power, shape (n, n).
    """
    return tuple(_siblings_of(child, row) for child, row in enumerate(correlation))


def _siblings_of(child: int, row: Sequence[float]) -> tuple[int, ...]:
    siblings = (sibling for sibling in range(len(row)) if sibling != child)
    return tuple(sorted(siblings, key=lambda sibling: (row[sibling], sibling)))
