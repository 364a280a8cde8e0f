"""Two messages are equal if they are so bit for bit, or within what is allowed."""

from __future__ import annotations

import math

import pytest

from bus_schemas.messages import Command, HelpGiven, Impp, Setpoint
from bus_schemas.signals import COMMAND, IMPP, SETPOINT
from recordings.verify.comparison import Equality, FieldDifference

NODE = "c1/a"


@pytest.mark.parametrize(
    ("recorded", "new", "tolerance", "equal"),
    [
        (0.0, -0.0, 0.0, False),
        (1.0, math.nextafter(1.0, 2.0), 0.0, False),
        (math.nan, math.nan, 0.0, True),
        (5.0, 5, 0.0, True),  # What a listener gets is the same.
        (0.0, -0.0, 1e-9, True),
        (1.0, 1.001, 0.0009, False),
        (1.0, 1.001, 0.0011, True),
        (1.0, math.nan, 1e9, False),
        (math.inf, -math.inf, 1e9, False),
    ],
)
def test_floats_are_equal_bit_for_bit_or_within_the_tolerance(
    recorded: float, new: float, tolerance: float, equal: bool
) -> None:
    old, now = (Command(3, 0, NODE, (), alpha=0.5, power_kw=kw) for kw in (recorded, new))
    found = Equality(tolerance).differences(COMMAND.of(NODE), old, now)
    assert [entry.field for entry in found] == ([] if equal else ["power_kw"])


def test_lists_of_one_length_differ_entry_by_entry_and_others_as_a_whole() -> None:
    def setpoint(*help_given: HelpGiven) -> Setpoint:
        return Setpoint(0, 0, "c1", (), power_kw=1.0, share_kw=1.0, help_given=help_given)

    old = setpoint(HelpGiven("c1/b", 1.0), HelpGiven("c1/c", 2.0))
    new = setpoint(HelpGiven("c1/b", 1.0), HelpGiven("c1/c", 2.5))
    port = SETPOINT.of(NODE)
    assert Equality().differences(port, old, new) == (
        FieldDifference("help_given[1][1]", 2.0, 2.5),
    )
    (whole,) = Equality().differences(port, old, setpoint())
    assert whole == FieldDifference("help_given", (["c1/b", 1.0], ["c1/c", 2.0]), ())


def test_a_tolerance_is_for_floats_alone_and_ignored_fields_are_named() -> None:
    def differing(equality: Equality) -> list[str]:
        old = Impp(0, 0, NODE, (), power_kw=1.0, stale_cycles=0)
        new = Impp(0, 7, NODE, (), 1, 2, 3, power_kw=1.1, stale_cycles=1)
        return [entry.field for entry in equality.differences(IMPP.of(NODE), old, new)]

    assert differing(Equality()) == ["sim_time_ns", "power_kw", "stale_cycles"]
    assert differing(Equality(10.0)) == ["sim_time_ns", "stale_cycles"]
    assert differing(Equality(10.0, frozenset({"stale_cycles"}))) == ["sim_time_ns"]
