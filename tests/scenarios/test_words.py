"""The user's words for durations and ranges, one grammar for all, and for parts of the machine."""

from __future__ import annotations

import pytest
from complaints import complaint_of

from scenarios.times import duration_s, parse_duration_s, split_range


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        *(("90s", 90), ("15m", 900), ("1h30m", 5400), ("0.5h", 1800), ("1h1m1s", 3661)),
        *(("50ms", 0.05), ("200us", 0.0002), ("1s500ms", 1.5), ("744h", 31 * 86400)),
    ],
)
def test_a_duration_has_units(text: str, seconds: float) -> None:
    assert duration_s(text) == pytest.approx(seconds)
    # The length of a run alone may be in seconds without a unit.
    assert duration_s(str(seconds)) is None
    for length in (text, f"{seconds:f}"):
        assert parse_duration_s(length, "--duration") == pytest.approx(seconds)


def test_wrong_durations_and_ranges_are_refused() -> None:
    for text in ("", "0", "-5", "soon", "5 s", "5d", "1e3", ".", "1..5", "1m1h", "745h", "9" * 99):
        assert complaint_of(parse_duration_s, text, "--duration").startswith("--duration: expected")
    assert split_range("30s..40s", "silent") == ("30s", "40s")
    for text in ("30s", "30s..", "..40s", ".."):
        assert complaint_of(split_range, text, "silent").startswith("silent: expected a range")
