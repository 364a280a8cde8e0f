"""When a process takes its interlude, by a clock that is set by hand."""

from __future__ import annotations

import gc

import pytest
from clock_by_hand import ClockByHand

from agents.interlude import Interlude

MS = 1_000_000
START = 5_000 * MS


class Stopwatch:
    """Has so much to settle whenever it is asked to; that takes a while on the clock.

    Attributes
    ----------
    takes_ms
        What there is to settle once.
    """

    def __init__(self, clock: ClockByHand, takes_ms: float) -> None:
        self.takes_ms = takes_ms
        self.settled_ms: list[float] = []
        self.rooms_made = 0
        self._left_ns = 0
        self._clock = clock

    def settle(self, until_ns: int | None = None) -> bool:
        now_ns = self._clock.now_ns
        if until_ns is not None and until_ns <= now_ns:
            return False
        self.settled_ms.append((now_ns - START) / MS)
        left_ns = self._left_ns or round(self.takes_ms * MS)
        ends_ns = now_ns + left_ns if until_ns is None else min(until_ns, now_ns + left_ns)
        self._clock.now_ns = ends_ns
        self._left_ns = left_ns - (ends_ns - now_ns)
        return not self._left_ns

    def make_room(self) -> None:
        self.rooms_made += 1


class Process:
    """A process of which each cycle takes a share; it looks for an interlude once in a while."""

    def __init__(
        self, cycle_ms: float, busy_ms: float, place: int = 0, takes_ms: float = 0.3
    ) -> None:
        self.clock = ClockByHand(START)
        self.stopwatch = Stopwatch(self.clock, takes_ms)
        self.told = 0
        self.lengths_ms: list[float] = []
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

    def run(self, lasts_ms: float, looks_every_ms: float, *, ends: bool = False) -> list[float]:
        """Return when interludes began, or when they were over, from the start [ms]."""
        end_ns = self.clock.now_ns + round(lasts_ms * MS)
        ends_ms: list[float] = []
        while self.clock.now_ns < end_ns:
            began_ns = self.clock.now_ns
            under_way, into_ns = divmod(began_ns - START, self.cycle_ns)
            self.interlude.consider(under_way + (into_ns >= self.busy_ns))
            if self.clock.now_ns > began_ns:
                ends_ms.append((self.clock.now_ns - START) / MS)
                self.lengths_ms.append((self.clock.now_ns - began_ns) / MS)
            self.clock.now_ns += round(looks_every_ms * MS)
        return ends_ms if ends else self.stopwatch.settled_ms


class Collector:
    """Collects garbage in a time on a clock by hand."""

    def __init__(self) -> None:
        self.collected_ms: list[float] = []
        self._clock = ClockByHand()
        self._takes_ns = 0

    def on(self, clock: ClockByHand, takes_ms: float) -> None:
        self._clock, self._takes_ns = clock, round(takes_ms * MS)

    def __call__(self) -> int:
        self.collected_ms.append((self._clock.now_ns - START) / MS)
        self._clock.now_ns += self._takes_ns
        return 0


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Collector:
    collector = Collector()
    monkeypatch.setattr(gc, "collect", collector)
    return collector


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


def test_one_that_was_missed_is_made_up_for_in_a_later_cycle() -> None:
    process = Process(cycle_ms=50.0, busy_ms=12.0)
    process.interlude.begin(START)
    process.clock.now_ns = START + 115 * MS
    assert process.run(30.0, looks_every_ms=1.0) == pytest.approx([125.0], abs=1.5)


@pytest.mark.parametrize(
    ("cycle_ms", "place"), [(50.0, 21), (10.0, 0), (10.0, 21), (5.0, 0), (5.0, 21)]
)
def test_after_a_slow_one_they_come_as_before(
    cycle_ms: float, place: int, collector: Collector
) -> None:
    process = Process(cycle_ms, busy_ms=0.3 * cycle_ms, place=place)
    process.interlude.begin(START)
    collector.on(process.clock, takes_ms=3.2)
    process.run(400.0, looks_every_ms=0.2)
    collector.on(process.clock, takes_ms=0.1)
    process.stopwatch.settled_ms.clear()
    collector.collected_ms.clear()
    assert len(process.run(5_000.0, looks_every_ms=0.2)) >= 24, "five a second"
    assert len(collector.collected_ms) >= 24
    assert process.told >= 5


@pytest.mark.parametrize("cycle_ms", [5.0, 10.0, 50.0, 1_000.0])
@pytest.mark.parametrize("place", [0, 11, 21])
def test_it_is_over_before_the_next_tick_however_much_there_is(
    cycle_ms: float, place: int, collector: Collector
) -> None:
    process = Process(cycle_ms, busy_ms=0.6 * cycle_ms, place=place, takes_ms=30.0)
    process.interlude.begin(START)
    collector.on(process.clock, takes_ms=0.2)
    ends_ms = process.run(60 * cycle_ms, looks_every_ms=0.1, ends=True)
    assert ends_ms
    assert max(end_ms % cycle_ms for end_ms in ends_ms) <= cycle_ms - 0.05
    assert max(process.lengths_ms) <= 2.3
    # 30 ms take many cycles, but they come to their end: then garbage is collected.
    assert collector.collected_ms


def test_for_whom_the_tick_came_too_soon_it_comes_once_its_part_is_done(
    collector: Collector,
) -> None:
    process = Process(cycle_ms=5.0, busy_ms=2.0, place=21)
    process.interlude.begin(START)
    collector.on(process.clock, takes_ms=0.1)
    # It wakes late: 0.08 ms before the tick there is no time for anything.
    process.clock.now_ns = START + round(4.92 * MS)
    assert process.run(4.0, looks_every_ms=0.02)[0] == pytest.approx(7.0, abs=0.05)


@pytest.mark.parametrize("cycle_ms", [5.0, 50.0, 1_000.0])
def test_whoever_is_never_done_in_time_takes_a_piece_all_the_same(
    cycle_ms: float, collector: Collector
) -> None:
    process = Process(cycle_ms, busy_ms=cycle_ms, takes_ms=30.0)
    process.interlude.begin(START)
    collector.on(process.clock, takes_ms=0.1)
    moments_ms = process.run(13_000.0, looks_every_ms=1.0)
    assert 4 <= len(moments_ms) <= 6, "every 2 to 3 s"
    assert len(collector.collected_ms) == process.told == len(moments_ms)
    assert max(process.lengths_ms) < 0.5


def test_whoever_is_never_idle_makes_room_in_each_turn(collector: Collector) -> None:
    process = Process(cycle_ms=50.0, busy_ms=12.0)
    process.interlude.begin(START)
    collector.on(process.clock, takes_ms=0.1)
    for _ in range(2_000):
        process.interlude.make_room()
        process.clock.now_ns += MS
    assert process.stopwatch.rooms_made == 2_000
    assert process.stopwatch.settled_ms == []
    for _ in range(100):
        process.interlude.make_room()
        process.clock.now_ns += MS
    assert process.stopwatch.settled_ms == pytest.approx([2_026.0], abs=1.5)


def test_who_stood_still_for_long_does_not_begin_with_an_interlude(collector: Collector) -> None:
    process = Process(cycle_ms=50.0, busy_ms=12.0)
    process.interlude.begin(START)
    process.clock.now_ns = START + 60_010 * MS
    process.interlude.make_room()
    process.interlude.consider(1_200)
    assert process.stopwatch.settled_ms == []


def test_in_arming_room_is_made_and_nothing_said() -> None:
    process = Process(cycle_ms=50.0, busy_ms=50.0)
    process.interlude.consider(-1_000_000)
    stopwatch = process.stopwatch
    assert (stopwatch.rooms_made, stopwatch.settled_ms, process.told) == (1, [], 0)
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
