"""Steps 3 and 4: the order in which children in need ask their siblings, and who gives what."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Numbers: TypeAlias = Sequence[float] | NDArray[np.float64]
    Orders: TypeAlias = Sequence[Sequence[int]] | NDArray[np.int64]


def help_order(correlation: Sequence[Sequence[float]]) -> tuple[tuple[int, ...], ...]:
    """Order each child's siblings by ascending correlation with it (eq. 5).

    Equal correlations keep the order of the children, so that the result is one and the same
    everywhere.

    Parameters
    ----------
    correlation
        Pearson correlation between the children's power, shape (n, n).
    """
    return tuple(
        tuple(sorted((other for other in range(len(row)) if other != child), key=row.__getitem__))
        for child, row in enumerate(correlation)
    )


def allocate(
    target_kw: float,
    ratings_kw: Numbers,
    impp_kw: Numbers,
    alpha_min: float,
    order: Orders,
    adds_up: bool,
) -> tuple[list[float], list[float], list[int], list[int], list[float]]:
    """Divide a target among n children (paper, section II-D).

    Each child's share is by rating, but not below its floor. A child that cannot meet its share
    gives its IMPP, and its siblings give what is missing, the least correlated first; none is
    raised above its IMPP.

    Parameters
    ----------
    target_kw
        Power that the children must give together, not negative.
    ratings_kw, impp_kw
        AC rating and estimated maximum power of each child, shape (n,).
    alpha_min
        Lowest curtailment level of an inverter. No child can give less than this share of its
        IMPP: its floor.
    order
        For each child the positions of its siblings, the one to ask first at the front, from
        `help_order`. In an array rows are filled up with -1.
    adds_up
        Whether the setpoints add up to a target that is more than the children have. Each is then
        asked for a part of the rest, by what it lacks to its rating: power that comes is needed.

    Returns
    -------
    power_kw : list of float
        The setpoints, shape (n,): from the floor to the IMPP, together min(target, sum of IMPP) or
        the sum of the floors, if that is more. With `adds_up`, the target itself if it is more.
    share_kw : list of float
        Each child's share of the target, before any help, shape (n,).
    donors, needy : list of int
        Positions of the children between whom help goes, a pair for each help line.
    given_kw : list of float
        Power that each of those donors gives.
    """
    count = len(ratings_kw)
    share_kw = _shares_kw(target_kw, ratings_kw, impp_kw, alpha_min)
    headroom_kw = [impp_kw[child] - share_kw[child] for child in range(count)]
    lacks_kw = [max(-headroom, 0.0) for headroom in headroom_kw]
    donors, needy, given_kw = _help_lines(lacks_kw, headroom_kw, order)
    impp_sum_kw = total(impp_kw)
    if target_kw >= impp_sum_kw:
        power_kw = [impp_kw[child] for child in range(count)]
        dark_kw = total(ratings_kw) - impp_sum_kw
        if adds_up and dark_kw > 0.0:
            part = (target_kw - impp_sum_kw) / dark_kw
            for child in range(count):
                power_kw[child] += part * (ratings_kw[child] - impp_kw[child])
    else:
        power_kw = [min(share_kw[child], impp_kw[child]) for child in range(count)]
        for line in range(len(donors)):
            donor = donors[line]
            power_kw[donor] = min(power_kw[donor] + given_kw[line], impp_kw[donor])
    return power_kw, share_kw, donors, needy, given_kw


def total(values: Numbers) -> float:
    """Return the sum in the order of the values, with the same bits everywhere.

    From Python 3.12 on `sum` compensates rounding errors; compiled code does not.
    """
    found = 0.0
    for value in values:
        found += value
    return found


def _shares_kw(
    target_kw: float, ratings_kw: Numbers, impp_kw: Numbers, alpha_min: float
) -> list[float]:
    """Split a target by rating; a child whose floor is higher gives that, the others the rest."""
    count = len(ratings_kw)
    rating_kw = total(ratings_kw)
    share_kw = [target_kw * (ratings_kw[child] / rating_kw) for child in range(count)]
    is_raised = [False] * count
    again = True
    while again:
        again = False
        for child in range(count):
            floor_kw = alpha_min * impp_kw[child]
            if not is_raised[child] and share_kw[child] < floor_kw:
                share_kw[child] = floor_kw
                is_raised[child] = again = True
        if again:
            rest_kw, rating_kw = target_kw, 0.0
            for child in range(count):
                if is_raised[child]:
                    rest_kw -= share_kw[child]
                else:
                    rating_kw += ratings_kw[child]
            for child in range(count):
                if not is_raised[child]:
                    share_kw[child] = rest_kw * (ratings_kw[child] / rating_kw)
    return share_kw


def _help_lines(
    lacks_kw: list[float], headroom_kw: list[float], order: Orders
) -> tuple[list[int], list[int], list[float]]:
    """Find donors for those that lack power; takes what they give from their headroom."""
    donors: list[int] = []
    needy: list[int] = []
    given_kw: list[float] = []
    for child in range(len(lacks_kw)):
        missing_kw = lacks_kw[child]
        for donor in order[child]:
            if missing_kw <= 0.0 or donor < 0:
                break
            power_kw = min(missing_kw, headroom_kw[donor])
            if power_kw > 0.0:
                donors.append(donor)
                needy.append(child)
                given_kw.append(power_kw)
                headroom_kw[donor] -= power_kw
                missing_kw -= power_kw
    return donors, needy, given_kw
