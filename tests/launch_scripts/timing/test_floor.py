"""The probes of the floor keep their periods; what cyclictest says is read whole."""

from __future__ import annotations

import os
import threading
import time
from itertools import pairwise
from pathlib import Path

import pytest

from agents.machine import MachineSettings
from launch_scripts.timing.cyclictest import Cyclictest, latencies
from launch_scripts.timing.distributions import distribution
from launch_scripts.timing.floor_probe import Probe


def test_a_probe_acts_once_a_period_from_absolute_times_even_after_a_stall() -> None:
    probe = Probe(period_ns=10_000_000)
    probe.hear("begin 0.3")
    due_ns: list[int] = []

    def act(time_ns: int) -> None:
        due_ns.append(time_ns)
        if len(due_ns) == 3:
            time.sleep(0.05)  # The periods that this delays are not left out.

    probe.on_each_period(act)
    steps = {later - earlier for earlier, later in pairwise(due_ns)}
    assert steps == {10_000_000}
    assert 5 <= len(due_ns) <= 26


def test_a_probe_ends_when_it_is_told_to_however_long_its_period() -> None:
    probe = Probe(period_ns=3_600_000_000_000)
    probe.hear("begin 7200")
    acted: list[int] = []
    thread = threading.Thread(target=probe.on_each_period, args=(acted.append,))
    thread.start()
    probe.hear("stop")
    thread.join(timeout=30.0)
    assert not thread.is_alive()
    assert probe.stopped
    assert len(acted) <= 1


def test_cyclictest_ends_by_itself_soon_after_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, words = tmp_path / "cyclictest", tmp_path / "words"
    program.write_text(f'#!/bin/sh\necho "$@" > {words}.part; mv {words}.part {words}; sleep 60\n')
    program.chmod(0o700)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    cyclictest = Cyclictest(50_000_000, MachineSettings())
    try:
        cyclictest.begin(90.5)
        until = time.monotonic() + 20.0
        while not words.exists() and time.monotonic() < until:
            time.sleep(0.02)
        assert words.read_text().startswith("--duration=151 --quiet")
    finally:
        cyclictest.end()


def test_what_cyclictest_says_becomes_a_histogram() -> None:
    document = b"""{"thread": {"0": {"histogram": {"50": 8, "100": 1}, "cycles": 10, "min": 50,
        "max": 123456, "avg": 60.5, "cpu": 0, "node": 0}}}"""
    found = distribution(latencies(document))
    assert found is not None
    # One wake-up was later than its histogram reaches: its maximum tells how late.
    assert found.count == 10
    assert found.p50_us == pytest.approx(50.0, rel=0.02)
    assert found.max_us == pytest.approx(123_456.0, rel=0.01)
