"""The probes of the floor keep their periods, and say why they could not measure."""

from __future__ import annotations

import pytest
from clock_by_hand import ClockByHand

from agents.machine import MachineSettings
from studies.timing.floor import Floor
from studies.timing.floor_probe import due_times

MS = 1_000_000


def test_a_probe_acts_once_a_period_from_absolute_times_even_after_a_stall() -> None:
    clock = ClockByHand()
    began_ns = clock.now_ns

    def never_stopped(seconds: float) -> bool:
        clock.sleep(seconds)
        return False

    acted: list[tuple[float, float]] = []
    for due_ns in due_times(10 * MS, began_ns + 300 * MS, clock, never_stopped):
        acted.append(((due_ns - began_ns) / MS, (clock.now_ns - began_ns) / MS))
        clock.now_ns += 45 * MS if len(acted) == 3 else MS
    # From 50 ms on, at which everybody is ready, to the end at 300 ms. The periods that the third
    # one delays, by 45 ms from 70 ms on, are not left out.
    delayed_ms = {80: 115, 90: 116, 100: 117, 110: 118}
    assert acted == [(due, delayed_ms.get(due, due)) for due in range(50, 301, 10)]


def test_a_probe_ends_when_it_is_told_to_however_long_its_period() -> None:
    clock = ClockByHand()
    waits: list[float] = []

    def stopped(seconds: float) -> bool:
        waits.append(seconds)
        return True

    assert list(due_times(3_600_000 * MS, clock.now_ns + 7_200_000 * MS, clock, stopped)) == []
    assert len(waits) == 1


@pytest.mark.processes
def test_the_floor_is_measured_by_processes_that_end_with_it() -> None:
    with Floor("by-hand", 20 * MS, MachineSettings()) as floor:
        assert floor.finish() == ()
        floor.begin(600.0)
        timer, round_trip = floor.finish()
    assert timer.name == "timer"
    assert timer.times is None or timer.times.count > 0
    assert round_trip.times is not None or round_trip.note
