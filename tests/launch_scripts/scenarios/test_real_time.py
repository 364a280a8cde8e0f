"""What a run in real time may ask of the clock."""

from __future__ import annotations

import pytest
from complaints import complaint_of

from bus_schemas.errors import InputError
from bus_schemas.tree import ControlTree
from launch_scripts.scenarios.real_time import SHORTEST_CYCLE_NS, cycle_wall_ns, tier_deadlines_ns

THREE_LAYERS = ControlTree((("c1/a", 100.0), ("c1/b", 100.0), ("c2/a", 100.0)))
SECOND_NS = 1_000_000_000


def test_a_cycle_too_short_for_any_clock_is_refused() -> None:
    assert cycle_wall_ns(1.0, 10_000.0, "--pace") == SHORTEST_CYCLE_NS
    found = complaint_of(cycle_wall_ns, 1.0, 20_000.0, "--pace")
    assert found.startswith("--pace 20000: expected cycles of 100 us or more")


def test_the_shortest_deadlines_leave_each_stage_what_it_takes_to_wake_a_process() -> None:
    shortest_ms = [0.5, 0.6, 0.7]
    found = tier_deadlines_ns(shortest_ms, THREE_LAYERS, 900_000)
    assert found == (500_000, 600_000, 700_000)
    with pytest.raises(InputError, match=r"at most 0\.699 ms"):
        tier_deadlines_ns(shortest_ms, THREE_LAYERS, 899_000)
    assert len(tier_deadlines_ns([1e3, 1e4, 6e4], THREE_LAYERS, 0)) == 3, "unused in lockstep"


@pytest.mark.parametrize(
    ("deadlines_ms", "expected"),
    [
        ([100.0, 200.0], ": expected 3 entries"),
        ([], ": expected 3 entries"),
        ([100.0, 100.0, 200.0], "[1]: expected 100.1 ms or more"),
        ([100.0, 200.0, 150.0], "[2]: expected 200.1 ms or more"),
        ([0.1, 500.0, 900.0], "[0]: expected 0.3 ms or more"),
        ([100.0, 500.0, 999.9999], "[2]: expected at most 999.8 ms"),
        ([60_000.0, 61_000.0, 62_000.0], "[2]: expected at most 999.8 ms"),
    ],
)
def test_impossible_deadlines_are_refused(deadlines_ms: list[float], expected: str) -> None:
    found = complaint_of(tier_deadlines_ns, deadlines_ms, THREE_LAYERS, SECOND_NS)
    assert found.startswith(f"control.deadlines_ms{expected}")
