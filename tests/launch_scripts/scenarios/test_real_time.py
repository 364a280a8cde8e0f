"""What a run in real time may ask of the clock."""

from __future__ import annotations

from math import inf, nan

import pytest

from bus_schemas.errors import InputError
from bus_schemas.tree import ControlTree
from launch_scripts.scenarios.real_time import SHORTEST_CYCLE_NS, cycle_wall_ns, tier_deadlines_ns

THREE_LAYERS = ControlTree((("c1/a", 100.0), ("c1/b", 100.0), ("c2/a", 100.0)))
SECOND_NS = 1_000_000_000


@pytest.mark.parametrize(
    ("cycle_s", "pace", "expected_ns"),
    [(1.0, 1.0, SECOND_NS), (4.0, 60.0, 66_666_667), (0.05, 1.0, 50_000_000), (1.0, "max", 0)],
)
def test_the_pace_says_how_long_a_cycle_is_on_the_wall_clock(
    cycle_s: float, pace: float, expected_ns: int
) -> None:
    assert cycle_wall_ns(cycle_s, pace, "--pace") == expected_ns


def test_a_cycle_too_short_for_any_clock_is_refused() -> None:
    assert cycle_wall_ns(1.0, 10_000.0, "--pace") == SHORTEST_CYCLE_NS
    with pytest.raises(InputError) as caught:
        cycle_wall_ns(1.0, 20_000.0, "--pace")
    text = str(caught.value)
    assert text.startswith(
        "--pace 20000: a cycle of 1 s would last 50 us, beyond the clock's resolution (it counts in"
    )
    assert text.endswith("accepted are cycles of 100 us or more")


def test_deadlines_are_those_of_the_scenario() -> None:
    found = tier_deadlines_ns([12.5, 20.0, 21.0], THREE_LAYERS, 50_000_000)
    assert found == (12_500_000, 20_000_000, 21_000_000)


def test_the_shortest_deadlines_leave_each_stage_what_it_takes_to_wake_a_process() -> None:
    shortest_ms = [0.5, 0.6, 0.7]
    found = tier_deadlines_ns(shortest_ms, THREE_LAYERS, 900_000)
    assert found == (500_000, 600_000, 700_000)
    with pytest.raises(InputError, match="the plant's apply"):
        tier_deadlines_ns(shortest_ms, THREE_LAYERS, 899_000)


def test_without_deadlines_each_stage_has_its_share() -> None:
    assert tier_deadlines_ns(None, THREE_LAYERS, SECOND_NS) == ()


def test_in_lockstep_deadlines_lie_idle_whatever_the_cycle() -> None:
    assert len(tier_deadlines_ns([1e3, 1e4, 6e4], THREE_LAYERS, 0)) == 3


@pytest.mark.parametrize(
    ("deadlines_ms", "expected"),
    [
        (
            [100.0, 200.0],
            "control.deadlines_ms has 2 entries, accepted is one for each of the 3 tiers, the "
            "central controller's first and the direct controllers' last",
        ),
        ([], "control.deadlines_ms has 0 entries, accepted is one for each of the 3 tiers, "),
        ([0.0, 1.0, 2.0], "control.deadlines_ms[0] is 0 ms, accepted is a number from 0.1 to"),
        ([1e-9, 500.0, 900.0], "control.deadlines_ms[0] is 1e-09 ms, accepted is a number from"),
        ([0.0001, 1.0, 2.0], "control.deadlines_ms[0] is 0.0001 ms, accepted is a number from"),
        ([1.0, -1.0, 2.0], "control.deadlines_ms[1] is -1 ms, accepted is a number from 0.1 to"),
        ([1.0, nan, 2.0], "control.deadlines_ms[1] is nan ms, accepted is a number from 0.1 to"),
        ([1.0, 2.0, inf], "control.deadlines_ms[2] is inf ms, accepted is a number from 0.1 to"),
        ([1.0, 2.0, 1e300], "control.deadlines_ms[2] is 1e+300 ms, accepted is a number from"),
        (
            [100.0, 100.0, 200.0],
            "control.deadlines_ms[1] is 100 ms, accepted is 0.1 ms more than that of the tier "
            "above it (100 ms), or later",
        ),
        (
            [100.0, 100.00001, 200.0],
            "control.deadlines_ms[1] is 100.00001 ms, accepted is 0.1 ms more than that of the",
        ),
        (
            [100.0, 200.0, 150.0],
            "control.deadlines_ms[2] is 150 ms, accepted is 0.1 ms more than that of the tier "
            "above it (200 ms), or later",
        ),
        (
            [100.0, 200.0, 1000.0],
            "control.deadlines_ms[2] is 1000 ms, accepted is less than the cycle on the wall "
            "clock, 1000 ms",
        ),
        (
            [0.1, 500.0, 900.0],
            "control.deadlines_ms[0] is 0.1 ms: the 3 stages from the tick to the central "
            "controller's solve share it, 33.3 us each, expected 0.3 ms or more",
        ),
        (
            [100.0, 500.0, 999.9999],
            "control.deadlines_ms[2] is 999.9999 ms: the plant's apply has half of the rest of "
            "the cycle, 0.05 us, accepted is at most 999.8 ms",
        ),
        (
            [60_000.0, 61_000.0, 62_000.0],
            "control.deadlines_ms[0] is 60000 ms, accepted is less than the cycle on the wall "
            "clock, 1000 ms",
        ),
    ],
)
def test_impossible_deadlines_are_refused(deadlines_ms: list[float], expected: str) -> None:
    with pytest.raises(InputError) as caught:
        tier_deadlines_ns(deadlines_ms, THREE_LAYERS, SECOND_NS)
    assert str(caught.value).startswith(expected)
