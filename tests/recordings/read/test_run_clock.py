"""Local time, time since the start and numbers name the same cycles."""

from __future__ import annotations

import pytest
from plans_by_hand import with_changes
from recordings_by_hand import PLAN

from bus_schemas.errors import InputError
from recordings.read.run_clock import RunClock

CLOCK = RunClock(PLAN, last_cycle=999)


@pytest.mark.parametrize(
    ("moment", "cycle"),
    [
        ("12:00", 0),
        ("12:01:30", 90),
        ("12:01:30.9", 90),
        ("2010-04-01T12:01:30", 90),
        ("2010-04-01T22:01:30+00:00", 90),
        ("90s", 90),
        ("90", 90),
        (90, 90),
        ("12:16:39", 999),
    ],
)
def test_a_moment_is_the_cycle_that_it_lies_in(moment: str | int, cycle: int) -> None:
    assert CLOCK.cycle(moment, "--from") == cycle


def test_a_time_of_day_is_the_first_one_in_the_run_also_after_midnight() -> None:
    late = with_changes(PLAN, start_time_ns=PLAN.timing.start_time_ns + 11 * 3600 * 10**9)  # 23:00
    clock = RunClock(late, last_cycle=2 * 3600 - 1)
    assert clock.cycle("23:00:10", "--from") == 10
    assert clock.cycle("00:30:00", "--from") == 90 * 60
    clock = RunClock(PLAN, last_cycle=30 * 3600)
    assert clock.cycle("13:00", "--from") == 3600
    assert clock.cycle("2010-04-02T13:00:00", "--from") == 25 * 3600


def test_a_span_ends_before_its_end() -> None:
    assert CLOCK.span("12:00:10", "12:00:12") == range(10, 12)
    assert CLOCK.span(None, 2) == range(2)
    assert (
        CLOCK.span("12:16:38", None)
        == CLOCK.span("c998", "12:16:40")
        == CLOCK.span(998, "cycle 1000")
        == range(998, 1000)
    )


OUTSIDE = "a time of the run, which goes from 2010-04-01 12:00:00 to 2010-04-01 12:16:39 HST (cycle"
NO_TIME = "a local time"


@pytest.mark.parametrize(
    ("moment", "expected"),
    [
        *(
            (one, OUTSIDE)
            for one in ("11:59:59", "12:16:40", "1000", "c1000", "2h", "9" * 300 + "h")
        ),
        *((one, NO_TIME) for one in ("", "noon", "25:00", "12:61", "c", "--", "90 s")),
    ],
)
def test_a_moment_that_is_none_of_the_run_is_refused(moment: str | int, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        CLOCK.cycle(moment, "--from")
    assert str(caught.value).startswith(f"--from: expected {expected}")
    assert str(caught.value).endswith(f", got {str(moment)[:40]}")


def test_a_span_that_is_none_is_refused() -> None:
    for end in ("11s", "12s"):
        with pytest.raises(InputError, match=f"--to: expected a time after 12:00:12, got {end}"):
            CLOCK.span("12:00:12", end)
    with pytest.raises(InputError, match="--to: expected a time of the run"):
        CLOCK.span(None, 1001)
    with pytest.raises(InputError, match="expected a time of the run"):
        RunClock(PLAN, last_cycle=-1).cycle(0, "--from")


def test_a_local_time_that_comes_twice_is_the_one_in_the_run() -> None:
    begins_ns = (
        1_382_835_600 * 10**9
    )  # 02:00 in Berlin on 27 October 2013, after the clocks went back.
    berlin = with_changes(PLAN, start_time_ns=begins_ns, timezone="Europe/Berlin")
    assert RunClock(berlin, last_cycle=3599).cycle("02:10", "--from") == 600
    before = with_changes(berlin, start_time_ns=begins_ns - 3600 * 10**9)
    assert RunClock(before, last_cycle=7199).cycle("02:10", "--from") == 600
    assert RunClock(before, last_cycle=7199).cycle("2013-10-27T02:10:00+01:00", "--from") == 4200
