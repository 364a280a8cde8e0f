"""Two messages are equal if they are so bit for bit, or within what was allowed."""

from __future__ import annotations

import math

import pytest

from bus_schemas.messages import Command, HelpGiven, Impp, Setpoint
from bus_schemas.signals import COMMAND, IMPP, SETPOINT
from recordings.verify.comparison import (
    COMPARED_FIELDS,
    NOT_COMPARED,
    Comparison,
    FieldDifference,
)

NODE = "c1/a"


def command(power_kw: float) -> Command:
    return Command(3, 0, NODE, (), 17, 4, alpha=0.5, power_kw=power_kw)


def differing(recorded: float, new: float, comparison: Comparison) -> list[str]:
    found = comparison.differences(COMMAND.of(NODE), command(recorded), command(new))
    return [entry.field for entry in found]


@pytest.mark.parametrize(
    ("recorded", "new"),
    [(0.0, -0.0), (1.0, math.nextafter(1.0, 2.0)), (1.0, math.nan), (math.inf, -math.inf)],
)
def test_floats_of_other_bits_differ(recorded: float, new: float) -> None:
    assert differing(recorded, new, Comparison()) == ["power_kw"]


@pytest.mark.parametrize("value", [0.0, -0.0, math.nan, math.inf, 5e-324])
def test_floats_of_the_same_bits_are_equal(value: float) -> None:
    assert differing(value, value, Comparison()) == []
    assert differing(value, value, Comparison(1.0)) == []


def test_a_tolerance_lets_zeros_of_either_sign_be_equal_and_nan_never() -> None:
    assert differing(0.0, -0.0, Comparison(1e-9)) == []
    assert differing(1.0, math.nan, Comparison(1e9)) == ["power_kw"]
    assert differing(math.inf, -math.inf, Comparison(1e9)) == ["power_kw"]


def test_a_whole_number_where_a_float_is_due_is_what_a_listener_would_get() -> None:
    assert differing(5.0, 5, Comparison()) == []
    assert differing(5.0, 6, Comparison()) == ["power_kw"]


def test_lists_of_one_length_differ_entry_by_entry_and_others_as_a_whole() -> None:
    def setpoint(*help_given: HelpGiven) -> Setpoint:
        return Setpoint(0, 0, "c1", (), power_kw=1.0, share_kw=1.0, help_given=help_given)

    old = setpoint(HelpGiven("c1/b", 1.0), HelpGiven("c1/c", 2.0))
    new = setpoint(HelpGiven("c1/b", 1.0), HelpGiven("c1/c", 2.5))
    port = SETPOINT.of(NODE)
    assert Comparison().differences(port, old, new) == (
        FieldDifference("help_given[1][1]", 2.0, 2.5),
    )
    (whole,) = Comparison().differences(port, old, setpoint())
    assert whole == FieldDifference("help_given", (["c1/b", 1.0], ["c1/c", 2.0]), ())


def test_a_tolerance_is_for_floats_alone() -> None:
    old = Impp(0, 0, NODE, (), power_kw=1.0, stale_cycles=0)
    new = Impp(0, 0, NODE, (), power_kw=1.1, stale_cycles=1)
    (found,) = Comparison(10.0).differences(IMPP.of(NODE), old, new)
    assert found.field == "stale_cycles"


def test_what_the_driver_fills_in_is_not_compared() -> None:
    assert not set(NOT_COMPARED) & set(COMPARED_FIELDS)
    assert {"power_kw", "missing", "help_given"} <= set(COMPARED_FIELDS)
