"""What holds of an allocation whatever the children, their power and the target."""

from math import fsum
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.control.allocation import allocate, total
from agents.control.neighbours import HelpOrder, help_order
from agents.control.request import request_kw

TOLERANCE_KW = 1e-6


class Case(NamedTuple):
    """A parent's problem."""

    target_kw: float
    capacities_kw: tuple[float, ...]
    impp_kw: tuple[float, ...]
    order: HelpOrder
    alpha_min: float = 0.0


class Allocation(NamedTuple):
    """What `allocate` returns, its help lines as (donor, needy, power)."""

    power_kw: list[float]
    share_kw: list[float]
    help_lines: list[tuple[int, int, float]]
    shortfall_kw: float


def solve(case: Case) -> Allocation:
    power_kw, share_kw, donors, needy, given_kw, shortfall_kw = allocate(
        case.target_kw, case.capacities_kw, case.impp_kw, case.alpha_min, case.order, False
    )
    lines = list(zip(donors, needy, given_kw, strict=True))
    return Allocation(power_kw, share_kw, lines, shortfall_kw)


def fractions(count: int) -> st.SearchStrategy[list[float]]:
    fraction = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0.0, 1.0))
    return st.lists(fraction, min_size=count, max_size=count)


@st.composite
def help_orders(draw: st.DrawFn, count: int) -> HelpOrder:
    row = st.lists(st.floats(-1.0, 1.0), min_size=count, max_size=count)
    return help_order(draw(st.lists(row, min_size=count, max_size=count)))


@st.composite
def capacities(draw: st.DrawFn, least: int) -> tuple[float, ...]:
    return tuple(draw(st.lists(st.floats(1e-3, 1e6), min_size=least, max_size=12)))


@st.composite
def cases(draw: st.DrawFn) -> Case:
    capacities_kw = draw(capacities(least=1))
    count = len(capacities_kw)
    impp_kw = tuple(
        share * capacity
        for share, capacity in zip(draw(fractions(count)), capacities_kw, strict=True)
    )
    target_kw = draw(
        st.one_of(
            st.sampled_from([0.0, 1e12, fsum(impp_kw), fsum(capacities_kw)]),
            st.floats(0.0, 2.0 * fsum(capacities_kw)),
        )
    )
    alpha_min = draw(st.sampled_from([0.0, 0.05, 0.5]))
    return Case(target_kw, capacities_kw, impp_kw, draw(help_orders(count)), alpha_min)


@st.composite
def cases_with_one_in_need(draw: st.DrawFn) -> tuple[Case, int]:
    """One child has less than its share, all others have at least theirs."""
    capacities_kw = draw(capacities(least=2))
    count = len(capacities_kw)
    target_kw = fsum(capacities_kw) * draw(st.floats(1e-3, 1.0))
    rating_kw = total(capacities_kw)
    share_kw = [request_kw(target_kw, capacity, rating_kw) for capacity in capacities_kw]
    impp_kw = [
        share * (1.0 + more) for share, more in zip(share_kw, draw(fractions(count)), strict=True)
    ]
    needy = draw(st.integers(0, count - 1))
    impp_kw[needy] = share_kw[needy] * draw(st.floats(0.0, 0.999))
    return Case(target_kw, capacities_kw, tuple(impp_kw), draw(help_orders(count))), needy


@given(cases())
def test_no_child_is_given_less_than_its_floor_or_more_than_its_impp(case: Case) -> None:
    for power_kw, impp_kw in zip(solve(case).power_kw, case.impp_kw, strict=True):
        assert case.alpha_min * impp_kw <= power_kw <= impp_kw


@given(cases())
def test_the_children_together_give_the_target_or_all_or_the_least_they_can(case: Case) -> None:
    found = solve(case)
    impp_kw = fsum(case.impp_kw)
    met_kw = max(min(case.target_kw, impp_kw), case.alpha_min * impp_kw)
    assert fsum(found.power_kw) == pytest.approx(met_kw, rel=0.0, abs=TOLERANCE_KW)


@given(cases())
def test_what_cannot_be_met_is_the_shortfall(case: Case) -> None:
    missing_kw = max(case.target_kw - fsum(case.impp_kw), 0.0)
    assert solve(case).shortfall_kw == pytest.approx(missing_kw, abs=TOLERANCE_KW)


@given(cases())
def test_help_lines_account_for_what_a_donor_gives_above_its_share(case: Case) -> None:
    found = solve(case)
    for child, (power_kw, share_kw) in enumerate(zip(found.power_kw, found.share_kw, strict=True)):
        given_kw = fsum(given for donor, _, given in found.help_lines if donor == child)
        above_kw = max(power_kw - share_kw, 0.0)
        assert given_kw == pytest.approx(above_kw, rel=0.0, abs=TOLERANCE_KW)


@given(cases())
def test_a_child_in_need_is_given_no_more_than_it_lacks(case: Case) -> None:
    found = solve(case)
    for child, (share_kw, impp_kw) in enumerate(zip(found.share_kw, case.impp_kw, strict=True)):
        got_kw = fsum(given for _, needy, given in found.help_lines if needy == child)
        lacks_kw = max(share_kw - impp_kw, 0.0)
        assert got_kw <= lacks_kw + TOLERANCE_KW
        if found.shortfall_kw == 0.0:
            assert got_kw == pytest.approx(lacks_kw, rel=0.0, abs=TOLERANCE_KW)


@given(cases())
def test_nobody_helps_itself_and_nobody_in_need_helps_another(case: Case) -> None:
    found = solve(case)
    for donor, needy, given_kw in found.help_lines:
        assert donor != needy
        assert given_kw > 0.0
        assert case.impp_kw[needy] < found.share_kw[needy]
        assert case.impp_kw[donor] > found.share_kw[donor]


@given(cases_with_one_in_need())
def test_a_later_donor_is_asked_only_when_the_earlier_ones_have_nothing_left(
    problem: tuple[Case, int],
) -> None:
    case, needy = problem
    found = solve(case)
    donors = [donor for donor, _, _ in found.help_lines]
    willing = [child for child in case.order[needy] if case.impp_kw[child] > found.share_kw[child]]
    assert donors == willing[: len(donors)]
    for donor in donors[:-1]:
        assert found.power_kw[donor] == pytest.approx(case.impp_kw[donor], abs=TOLERANCE_KW)
    if found.shortfall_kw == 0.0:
        for child in willing[len(donors) :]:
            assert found.power_kw[child] == found.share_kw[child]
