"""Step 2: what is asked of each child, and what it has left or lacks."""

from __future__ import annotations

from collections.abc import Sequence
from math import fsum


def split_by_capacity(power_kw: float, capacities_kw: Sequence[float]) -> tuple[float, ...]:
    """Split a power among children in proportion to their capacities (eq. 3).

    Equal capacities give the paper's P_desired / N.

    Parameters
    ----------
    power_kw
        Power to split, not negative.
    capacities_kw
        AC rating of each child, shape (n,), each above zero.

    Returns
    -------
    tuple of float
        Power for each child [kW], shape (n,).
    """
    total_kw = fsum(capacities_kw)
    return tuple(power_kw * (capacity_kw / total_kw) for capacity_kw in capacities_kw)


def residual_kw(impp_kw: float, request_kw: float) -> float:
    """Return what a node could give beyond its request (eq. 4) [kW]; negative: it needs help."""
    return impp_kw - request_kw

def request_kw(d, r, pr): return d*(r/pr)
