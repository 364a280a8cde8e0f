"""What live agents say is held against what they said, whichever of the two comes first."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace

from bus_schemas.messages import Help, Impp, Timing
from bus_schemas.signals import HELP, IMPP, TIMING
from launch_scripts.replay.output_comparison import OutputComparison

NODE = "c1/a"
PORT = IMPP.of(NODE)


def impp(cycle: int, power_kw: float = 50.0, **fields: object) -> Impp:
    """What an inverter says in a cycle."""
    message = Impp(cycle, 0, NODE, (), power_kw=power_kw, stale_cycles=0)
    return replace(message, **fields)


@pytest.mark.parametrize("new_first", [False, True])
def test_publish_time_and_sequence_do_not_count(new_first: bool) -> None:
    comparison = OutputComparison()
    recorded, new = impp(3, publish_time_ns=1, sequence=3), impp(3, publish_time_ns=9, sequence=4)
    if new_first:
        comparison.take_new(PORT, new)
        comparison.take_recorded(PORT, recorded)
    else:
        comparison.take_recorded(PORT, recorded)
        comparison.take_new(PORT, new)
    comparison.conclude(10)
    assert comparison.compared == 1
    assert not comparison.differing
    assert comparison.differences == []


@pytest.mark.parametrize("new_first", [False, True])
def test_a_field_that_differs_in_its_last_bit_is_told_with_both_values(new_first: bool) -> None:
    comparison = OutputComparison()
    other_kw = math.nextafter(50.0, 60.0)
    if new_first:
        comparison.take_new(PORT, impp(3, other_kw))
    comparison.take_recorded(PORT, impp(3))
    if not new_first:
        comparison.take_new(PORT, impp(3, other_kw))
    comparison.conclude(10)
    (found,) = comparison.differences
    assert (found.agent, found.cycle, found.key) == (NODE, 3, "c1/a/impp")
    assert (found.kind, found.field, found.recorded, found.new) == (
        "differs",
        "power_kw",
        50.0,
        other_kw,
    )
    assert dict(comparison.differing) == {NODE: 1}


def test_a_message_without_its_counterpart_is_a_difference() -> None:
    comparison = OutputComparison()
    asked = Help(4, 0, NODE, (), missing_kw=3.0)
    comparison.take_recorded(HELP.of(NODE), asked)
    comparison.take_new(HELP.of(NODE), replace(asked, cycle=2))
    comparison.conclude(10)
    assert [(d.cycle, d.kind) for d in comparison.differences] == [
        (2, "only new"),
        (4, "only recorded"),
    ]
    assert comparison.differing[NODE] == 2


def test_what_lies_behind_the_end_is_not_missed() -> None:
    comparison = OutputComparison()
    comparison.take_recorded(PORT, impp(9))
    comparison.take_recorded(PORT, impp(10))
    comparison.conclude(10)
    assert [difference.cycle for difference in comparison.differences] == [9]


def test_a_message_that_had_other_inputs_is_one_difference_of_its_own_kind() -> None:
    comparison = OutputComparison()
    comparison.take_recorded(PORT, impp(3, 50.0, missing=("c1/a/telemetry",)))
    comparison.take_new(PORT, impp(3, 40.0))
    (found,) = comparison.differences
    assert (found.kind, found.field) == ("other inputs", "missing")
    assert (found.recorded, found.new) == (("c1/a/telemetry",), ())


def test_a_message_that_came_twice_is_one_too_many() -> None:
    comparison = OutputComparison()
    comparison.take_recorded(PORT, impp(3))
    comparison.take_new(PORT, impp(3))
    comparison.take_new(PORT, impp(3))
    comparison.conclude(10)
    assert [difference.kind for difference in comparison.differences] == ["only new"]


def test_many_differences_are_counted_and_the_first_are_kept() -> None:
    comparison = OutputComparison()
    for cycle in range(1500):
        comparison.take_recorded(PORT, impp(cycle, 50.0))
        comparison.take_new(PORT, impp(cycle, 51.0))
    comparison.conclude(1500)
    assert comparison.differing[NODE] == 1500
    assert [difference.cycle for difference in comparison.differences] == list(range(1000))


def test_what_a_process_counts_of_itself_is_not_compared() -> None:
    comparison = OutputComparison()
    counts = Timing(
        3,
        0,
        NODE,
        (),
        missed_deadlines=1,
        missing_inputs=1,
        late_used=0,
        overruns=0,
        dropped=0,
        slowest_decision_ns=5,
    )
    comparison.take_recorded(TIMING.of(NODE), counts)
    comparison.take_new(TIMING.of(NODE), replace(counts, cycle=4, overruns=7))
    comparison.conclude(10)
    assert comparison.compared == 0
    assert not comparison.differing
