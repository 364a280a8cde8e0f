"""Times and durations in the user's words: one grammar for all."""

from __future__ import annotations

from datetime import UTC, datetime, time

import pytest

from bus_schemas.errors import InputError
from bus_schemas.times import duration_s, parse_duration_s, read_time, split_range


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        *(("90s", 90), ("15m", 900), ("1h30m", 5400), ("0.5h", 1800), ("1h1m1s", 3661)),
        *(("50ms", 0.05), ("200us", 0.0002), ("1s500ms", 1.5), ("744h", 31 * 86400)),
    ],
)
def test_a_duration_has_units(text: str, seconds: float) -> None:
    assert duration_s(text) == pytest.approx(seconds)
    assert parse_duration_s(text, "--duration") == pytest.approx(seconds)


def test_the_length_of_a_run_may_be_in_seconds_without_a_unit() -> None:
    assert duration_s("90") is None
    assert parse_duration_s("90", "--duration") == 90.0


@pytest.mark.parametrize(
    "text", ["", "0", "-5", "soon", "5 s", "5d", "1e3", ".", "1..5", "1m1h", "745h", "9" * 99]
)
def test_what_is_no_length_of_a_run_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--duration: expected"):
        parse_duration_s(text, "--duration")


@pytest.mark.parametrize(
    ("text", "moment"),
    [
        ("12:30", time(12, 30)),
        ("9:05:07", time(9, 5, 7)),
        ("2010-04-01T12:30", datetime(2010, 4, 1, 12, 30)),
        ("2010-04-01 9:05", datetime(2010, 4, 1, 9, 5)),
        ("2010-04-01T12:30Z", datetime(2010, 4, 1, 12, 30, tzinfo=UTC)),
        *((text, None) for text in ("", "noon", "25:00", "12:60", "2010-13-01T12:00", "90s")),
    ],
)
def test_a_time_is_one_of_day_or_has_a_date(text: str, moment: time | datetime | None) -> None:
    assert read_time(text) == moment


def test_a_range_has_two_ends() -> None:
    assert split_range("30s..40s", "silent") == ("30s", "40s")
    for text in ("30s", "30s..", "..40s", ".."):
        with pytest.raises(InputError, match="silent: expected a range"):
            split_range(text, "silent")
