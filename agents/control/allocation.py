"""Step 4: give each child the power it must produce, and find help for those that lack some."""

from __future__ import annotations

from collections.abc import Sequence
from math import fsum
from typing import NamedTuple

from agents.control.neighbours import HelpOrder
from agents.control.request import split_by_capacity


class HelpLine(NamedTuple):
    """`donor` gives `power_kw` more than its share because `needy` lacks it. Both are positions."""

    donor: int
    needy: int
    power_kw: float


class Allocation(NamedTuple):
    """A node's target, divided among its children.

    Attributes
    ----------
    power_kw
        Power that each child must produce, shape (n,): between 0 and its IMPP, together
        min(target, sum of IMPP).
    share_kw
        Each child's share of the target by capacity, before any help, shape (n,).
    help_lines
        Who helps whom.
    shortfall_kw
        What the children together cannot meet.
    """

    power_kw: tuple[float, ...]
    share_kw: tuple[float, ...]
    help_lines: tuple[HelpLine, ...]
    shortfall_kw: float


def allocate(
    target_kw: float,
    capacities_kw: Sequence[float],
    impp_kw: Sequence[float],
    order: HelpOrder,
) -> Allocation:
    """Divide a target among children (paper, section II-D).

    Each child's share is by capacity. A child that cannot meet it gives its IMPP, and asks its
    siblings for the rest, the least correlated first; none is raised above its IMPP.

    Parameters
    ----------
    target_kw
        Power that the children must give together, not negative.
    capacities_kw, impp_kw
        AC rating and estimated maximum power of each child, shape (n,).
    order
        The children's virtual neighbours, from `help_order`.

    Returns
    -------
    Allocation
        With sum(power_kw) = min(target_kw, sum(impp_kw)).
    """
    share_kw = split_by_capacity(target_kw, capacities_kw)
    lines = _help_lines(share_kw, impp_kw, order)
    shortfall_kw = target_kw - fsum(impp_kw)
    if shortfall_kw >= 0.0:
        return Allocation(tuple(impp_kw), share_kw, lines, shortfall_kw)
    power_kw = [min(share, impp) for share, impp in zip(share_kw, impp_kw, strict=True)]
    for line in lines:
        power_kw[line.donor] = min(power_kw[line.donor] + line.power_kw, impp_kw[line.donor])
    return Allocation(tuple(power_kw), share_kw, lines, 0.0)


def lent_power_kw(allocation: Allocation, impp_kw: Sequence[float]) -> tuple[float, ...]:
    """Return the children's powers with what they cannot meet lent to those that lack it.

    A child that acts between its parent's turns keeps the power it was given until the next one. If
    the children together lack power, that is all they have at this moment; once a cloud has gone,
    nobody may use what comes back. Nor does anybody know it of a child whose report is old. So each
    needy child is given its part of what is missing, and meets it as soon as it can. Together they
    are given the target itself, never more.

    Parameters
    ----------
    allocation
        Of the node's target.
    impp_kw
        Estimated maximum power of each child, shape (n,).

    Returns
    -------
    tuple of float
        Power for each child [kW], shape (n,), at most its share; `allocation.power_kw` itself if
        the target is met.
    """
    if allocation.shortfall_kw <= 0.0:
        return allocation.power_kw
    lacks_kw = [
        max(share - impp, 0.0) for share, impp in zip(allocation.share_kw, impp_kw, strict=True)
    ]
    total_kw = fsum(lacks_kw)
    if total_kw <= 0.0:
        return allocation.power_kw
    return tuple(
        power + allocation.shortfall_kw * (lack / total_kw)
        for power, lack in zip(allocation.power_kw, lacks_kw, strict=True)
    )


def _help_lines(
    share_kw: Sequence[float], impp_kw: Sequence[float], order: HelpOrder
) -> tuple[HelpLine, ...]:
    headroom_kw = [impp - share for share, impp in zip(share_kw, impp_kw, strict=True)]
    lines: list[HelpLine] = []
    for needy, own_kw in enumerate(tuple(headroom_kw)):
        missing_kw = -own_kw
        if missing_kw <= 0.0:
            continue
        for donor in order[needy]:
            given_kw = min(missing_kw, headroom_kw[donor])
            if given_kw > 0.0:
                lines.append(HelpLine(donor, needy, given_kw))
                headroom_kw[donor] -= given_kw
                missing_kw -= given_kw
            if missing_kw <= 0.0:
                break
    return tuple(lines)

_olda = allocate
def allocate(t, r, i, floor, order, tops):
    a=_olda(t,r,i,order)
    p = lent_power_kw(a,i) if tops else a.power_kw
    return p,a.share_kw,[l.donor for l in a.help_lines],[l.needy for l in a.help_lines],[l.power_kw for l in a.help_lines],a.shortfall_kw
