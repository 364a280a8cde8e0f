"""The probes of the floor keep their periods; what cyclictest says is read whole."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest
from clock_by_hand import ClockByHand

from agents.machine import MachineSettings
from launch_scripts.timing.cyclictest import Cyclictest, latencies
from launch_scripts.timing.distributions import distribution
from launch_scripts.timing.floor_probe import Probe

MS = 1_000_000


def test_a_probe_acts_once_a_period_from_absolute_times_even_after_a_stall() -> None:
    clock = ClockByHand()
    began_ns = clock.now_ns
    probe = Probe(10 * MS, clock, clock.sleep)
    probe.hear("begin 0.3")
    acted: list[tuple[int, int]] = []

    def act(due_ns: int) -> None:
        acted.append((due_ns, clock.now_ns))
        clock.now_ns += 45 * MS if len(acted) == 3 else MS

    probe.on_each_period(act)
    # From 50 ms on, at which everybody is ready, to the end at 300 ms.
    due_ms = [*range(50, 301, 10)]
    assert [(due_ns - began_ns) / MS for due_ns, _ in acted] == due_ms
    # The periods that the third one delays, by 45 ms from 70 ms on, are not left out.
    delayed_ms = {80: 115, 90: 116, 100: 117, 110: 118}
    acted_ms = [(acted_ns - began_ns) / MS for _, acted_ns in acted]
    assert acted_ms == [delayed_ms.get(due, due) for due in due_ms]


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
    program.write_text(
        f'#!/bin/sh\necho "$@" > {words}.part; mv {words}.part {words}; exec sleep 60\n'
    )
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
