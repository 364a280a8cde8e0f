"""The user's words for durations and ranges, one grammar for all, and for parts of the machine."""

from __future__ import annotations

import os

import pytest
from complaints import complaint_of

from agents.process.machine import MachineSettings
from scenarios.real_time import machine_settings
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


# What a run may take of the machine ---------------------------------------------------------------


def test_processors_are_listed_as_the_kernel_does_and_kinds_may_have_their_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 3})  # All but CPU 2 of four.
    found = machine_settings(["3,0-1", "plant=3", "direct=1,0"], 20)
    assert found == MachineSettings((0, 1, 3), {"plant": (3,), "direct": (0, 1)}, 20)
    for word in ("0-2", "3-1", "inverter=0", "=0", "plant=", "0,", "-1", "all", "0-99999999"):
        assert complaint_of(machine_settings, [word]).startswith(f"--cpus {word}: expected")
