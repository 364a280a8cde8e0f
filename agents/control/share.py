"""Step 2: the share of a node."""

from __future__ import annotations


def usable_dispatch_kw(dispatch_kw: float, plant_rating_kw: float) -> float:
    """Return the dispatch, clamped to the range from 0 to the plant's rating [kW]."""
    return min(max(dispatch_kw, 0.0), plant_rating_kw)


def share_kw(dispatch_kw: float, rating_kw: float, plant_rating_kw: float) -> float:
    """Return a node's own share of the dispatch, by rating (eq. 3) [kW].

    Equal ratings give the paper's P_desired / N. The shares of a node's children add up to its
    own.
    """
    return dispatch_kw * (rating_kw / plant_rating_kw)
