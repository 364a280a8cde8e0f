"""When a process takes its interlude, by a clock that is set by hand."""

from __future__ import annotations

import gc
from dataclasses import dataclass

import pytest

from agents.interlude import Interlude

MS = 1_000_000
START = 5_000 * MS


@dataclass
class Clock:
    now_ns: int = START

    def __call__(self) -> int:
        return self.now_ns


class Stopwatch:
    """Counts how often it is settled; that takes a while on the clock."""

    def __init__(self, clock: Clock, takes_ms: float) -> None:
        self.overfull = False
        self.settled_ms: list[float] = []
        self._clock = clock
        self._takes_ns = round(takes_ms * MS)

    def settle(self) -> None:
        self.settled_ms.append((self._clock.now_ns - START) / MS)
        self._clock.now_ns += self._takes_ns


class Process:
    """A process of which each cycle takes a share; it looks for an interlude once in a while."""

    def __init__(
        self, cycle_ms: float, busy_ms: float, place: int = 0, takes_ms: float = 0.3
    ) -> None:
        self.clock = Clock()
        self.stopwatch = Stopwatch(self.clock, takes_ms)
        self.told = 0
        self.cycle_ns, self.busy_ns = round(cycle_ms * MS), round(busy_ms * MS)
        self.interlude = Interlude(
            self.stopwatch,  # type: ignore[arg-type]
            self.tell,
            self.cycle_ns,
            place,
            22,
            self.clock,
        )

    def tell(self) -> None:
        self.told += 1

    def run(self, lasts_ms: float, looks_every_ms: float) -> list[float]:
        """Return when interludes began, from the start [ms]."""
        end_ns = self.clock.now_ns + round(lasts_ms * MS)
        while self.clock.now_ns < end_ns:
            under_way, into_ns = divmod(self.clock.now_ns - START, self.cycle_ns)
            self.interlude.consider(under_way + (into_ns >= self.busy_ns))
            self.clock.now_ns += round(looks_every_ms * MS)
        return self.stopwatch.settled_ms


def test_it_comes_five_times_a_second_in_the_second_half_of_the_cycle() -> None:
    process = Process(cycle_ms=50.0, busy_ms=12.0)
    process.interlude.begin(START)
    assert process.interlude.left_s(0) == pytest.approx(0.025)
    moments_ms = process.run(900.0, looks_every_ms=1.0)
    assert moments_ms == pytest.approx([25.0, 225.0, 425.0, 625.0, 825.0], abs=2.0)


def test_with_cycles_that_are_longer_it_comes_in_each() -> None:
    process = Process(cycle_ms=1_000.0, busy_ms=12.0)
    process.interlude.begin(START)
    assert process.run(2_900.0, looks_every_ms=1.0) == pytest.approx([500.0, 1500.0, 2500.0], abs=2)


def test_what_has_changed_is_said_once_a_second() -> None:
    process = Process(cycle_ms=50.0, busy_ms=12.0)
    process.interlude.begin(START)
    assert len(process.run(3_500.0, looks_every_ms=1.0)) == 18
    assert process.told == 4


def test_each_process_has_a_moment_of_its_own() -> None:
    moments_s = []
    for place in range(22):
        process = Process(cycle_ms=1_000.0, busy_ms=20.0, place=place)
        process.interlude.begin(START)
        left_s = process.interlude.left_s(1)
        assert left_s is not None
        moments_s.append(left_s)
    assert moments_s == sorted(set(moments_s))
    assert (moments_s[0], max(moments_s) < 0.9) == (0.5, True)


def test_it_waits_until_the_process_has_done_its_part() -> None:
    process = Process(cycle_ms=50.0, busy_ms=45.0)
    process.interlude.begin(START)
    assert process.run(49.0, looks_every_ms=0.5) == pytest.approx([45.0], abs=0.6)


def test_a_busy_process_does_not_look_for_it_again_and_again() -> None:
    process = Process(cycle_ms=50.0, busy_ms=45.0)
    process.interlude.begin(START)
    process.clock.now_ns = START + 30 * MS
    assert process.interlude.left_s(0) is None
    assert process.interlude.left_s(1) == 0.0


def test_a_process_that_is_never_done_in_time_has_none() -> None:
    process = Process(cycle_ms=50.0, busy_ms=50.0)
    process.interlude.begin(START)
    assert process.run(3_000.0, looks_every_ms=0.5) == []


def test_one_that_was_missed_is_made_up_for_in_a_later_cycle() -> None:
    process = Process(cycle_ms=50.0, busy_ms=12.0)
    process.interlude.begin(START)
    process.clock.now_ns = START + 115 * MS
    assert process.run(30.0, looks_every_ms=1.0) == pytest.approx([125.0], abs=1.5)


def test_there_is_none_where_it_would_not_be_over_before_the_next_tick() -> None:
    slow = Process(cycle_ms=50.0, busy_ms=12.0, takes_ms=13.0)
    slow.interlude.begin(START)
    # The first one shows how long it takes: twice that does not fit into the rest of the cycle.
    assert len(slow.run(1_000.0, looks_every_ms=1.0)) == 1


def test_it_comes_all_the_same_when_too_much_is_noted() -> None:
    process = Process(cycle_ms=50.0, busy_ms=50.0)
    process.interlude.begin(START)
    process.stopwatch.overfull = True
    process.interlude.consider(0)
    assert process.stopwatch.settled_ms == [0.0]


def test_whoever_is_never_idle_makes_room_only_when_too_much_is_noted() -> None:
    process = Process(cycle_ms=50.0, busy_ms=12.0)
    process.interlude.begin(START)
    process.clock.now_ns = START + 30 * MS
    process.interlude.make_room()
    assert process.stopwatch.settled_ms == []
    process.stopwatch.overfull = True
    process.interlude.make_room()
    assert process.stopwatch.settled_ms == [30.0]


def test_what_arming_notes_is_settled_and_nothing_said() -> None:
    process = Process(cycle_ms=50.0, busy_ms=50.0)
    process.stopwatch.overfull = True
    process.interlude.consider(-1_000_000)
    assert (process.stopwatch.settled_ms, process.told) == ([0.0], 0)
    assert process.interlude.left_s(-1_000_000) is None


def test_before_cycle_0_there_is_none() -> None:
    process = Process(cycle_ms=50.0, busy_ms=12.0)
    assert process.interlude.left_s(-1) is None
    assert process.run(500.0, looks_every_ms=1.0) == []


def test_garbage_is_collected_in_it() -> None:
    process = Process(cycle_ms=50.0, busy_ms=12.0)
    process.interlude.begin(START)
    collections = [entry["collections"] for entry in gc.get_stats()]
    process.run(100.0, looks_every_ms=1.0)
    assert gc.get_stats()[2]["collections"] > collections[2]
