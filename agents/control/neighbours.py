"""Step 3: virtual neighbours, the order in which a child in need asks its siblings for help."""

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
    return tuple(
        tuple(sorted((place for place in range(len(row)) if place != child), key=row.__getitem__))
        for child, row in enumerate(correlation)
    )
