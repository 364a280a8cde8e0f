"""Step 4: a target is divided among children, and those that lack power are helped."""

from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.control import allocation
from agents.control.allocation import help_order

FOUR = (100.0, 100.0, 100.0, 100.0)
IN_ORDER = ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))


class Allocation(NamedTuple):
    """What `allocate` returns, its help lines as (donor, needy, power)."""

    power_kw: list[float]
    share_kw: list[float]
    help_lines: list[tuple[int, int, float]]


def allocate(
    target_kw: float,
    ratings_kw: tuple[float, ...],
    impp_kw: tuple[float, ...],
    order: tuple[tuple[int, ...], ...],
    *,
    alpha_min: float = 0.0,
    adds_up: bool = False,
) -> Allocation:
    power_kw, share_kw, donors, needy, given_kw = allocation.allocate(
        target_kw, ratings_kw, impp_kw, alpha_min, order, adds_up
    )
    lines = list(zip(donors, needy, given_kw, strict=True))
    return Allocation(power_kw, share_kw, lines)


@pytest.mark.parametrize(
    ("impp_kw", "first_asked", "power_kw", "help_lines"),
    [
        # Each can give its share of 50 kW.
        ((60.0, 70.0, 80.0, 90.0), (1, 2, 3), [50.0] * 4, []),
        # Child 0 has 30 of its 50 kW: 20 kW are missing. Child 2 has 90 - 50 = 40 kW to spare.
        ((30.0, 90.0, 90.0, 90.0), (2, 3, 1), [30.0, 50.0, 70.0, 50.0], [(2, 0, 20.0)]),
        # 50 kW are missing: 15 from child 3 (65 - 50), 30 from child 1 (80 - 50), 5 from child 2.
        (
            (0.0, 80.0, 90.0, 65.0),
            (3, 1, 2),
            [0.0, 80.0, 55.0, 65.0],
            [(3, 0, 15.0), (1, 0, 30.0), (2, 0, 5.0)],
        ),
        # Both lack 20 kW. Child 2 has 30 kW to spare: 20 for child 0, 10 for child 1, whose other
        # 10 kW come from child 3.
        (
            (30.0, 30.0, 80.0, 90.0),
            (1, 2, 3),
            [30.0, 30.0, 80.0, 60.0],
            [(2, 0, 20.0), (2, 1, 10.0), (3, 1, 10.0)],
        ),
        # 10 + 60 + 20 + 70 = 160 kW are there. Child 0 lacks 40 and gets the 10 of child 1 and the
        # 20 of child 3; child 2 comes too late.
        (
            (10.0, 60.0, 20.0, 70.0),
            (1, 2, 3),
            [10.0, 60.0, 20.0, 70.0],
            [(1, 0, 10.0), (3, 0, 20.0)],
        ),
    ],
    ids=["no need", "the first alone", "the next too", "two in need", "beyond reach"],
)
def test_200_kw_of_four_children(
    impp_kw: tuple[float, ...],
    first_asked: tuple[int, ...],
    power_kw: list[float],
    help_lines: list[tuple[int, int, float]],
) -> None:
    found = allocate(200.0, FOUR, impp_kw, (first_asked, *IN_ORDER[1:]))
    assert found == Allocation(power_kw, [50.0] * 4, help_lines)


THREE = (100.0, 100.0, 100.0)


@pytest.mark.parametrize(
    ("target_kw", "impp_kw", "power_kw"),
    [
        # 9 kW are 3 for each, but child 0 cannot go below 5 % of 80 kW = 4: the others share 5.
        (9.0, (80.0, 40.0, 30.0), [4.0, 2.5, 2.5]),
        # 7.2 kW are 2.4 for each. Child 0 stays at 4, which leaves 1.6 for each of the others:
        # child 1 stays at 2, and child 2 gives the 1.2 that remain.
        (7.2, (80.0, 40.0, 10.0), [4.0, 2.0, 1.2]),
        # 12 kW are 4 for each. Child 0 gives at least 6, so that the others are asked for 3, of
        # which child 2 lacks 2.
        (12.0, (120.0, 50.0, 1.0), [6.0, 5.0, 1.0]),
        (0.0, (80.0, 40.0, 0.0), [4.0, 2.0, 0.0]),
    ],
)
def test_a_child_at_its_floor_gives_more_than_its_share_and_the_others_give_way(
    target_kw: float, impp_kw: tuple[float, ...], power_kw: list[float]
) -> None:
    found = allocate(target_kw, THREE, impp_kw, ((1, 2), (0, 2), (1, 0)), alpha_min=0.05)
    assert found.power_kw == pytest.approx(power_kw)


@given(
    st.lists(st.tuples(st.floats(1.0, 500.0), st.floats(0.0, 1.0)), min_size=1, max_size=8),
    st.floats(0.0, 1.0),
)
def test_powers_that_add_up_to_the_target_stay_within_the_ratings(
    children: list[tuple[float, float]], share: float
) -> None:
    ratings_kw = tuple(rating for rating, _ in children)
    impp_kw = tuple(rating * light for rating, light in children)
    target_kw = share * sum(ratings_kw)
    order = help_order([[0.0] * len(children)] * len(children))
    found = allocate(target_kw, ratings_kw, impp_kw, order, adds_up=True)
    assert sum(found.power_kw) == pytest.approx(target_kw, abs=1e-6)
    for power_kw, rating_kw in zip(found.power_kw, ratings_kw, strict=True):
        assert power_kw <= rating_kw + 1e-9


@pytest.mark.parametrize(
    ("correlation", "order"),
    [
        (
            [[1.0, 0.9, 0.2, 0.5], [0.9, 1.0, 0.4, 0.3], [0.2, 0.4, 1.0, 0.8], [0.5, 0.3, 0.8, 1]],
            ((2, 3, 1), (3, 2, 0), (0, 1, 3), (1, 0, 2)),
        ),
        ([[1.0, 0.0, -0.7], [0.0, 1.0, 0.1], [-0.7, 0.1, 1.0]], ((2, 1), (0, 2), (0, 1))),
        ([[1.0] * 4] * 4, ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))),
        ([[-1.0, 1.0], [1.0, -1.0]], ((1,), (0,))),
        ([[1.0]], ((),)),
    ],
    ids=["plain", "opposite before unrelated", "alike: as listed", "never oneself", "only child"],
)
def test_each_child_asks_the_least_correlated_sibling_first(
    correlation: list[list[float]], order: tuple[tuple[int, ...], ...]
) -> None:
    assert help_order(correlation) == order
