"""When messages are due: spacing on the recorded, rate, pause and seek."""

from __future__ import annotations

import pytest
from clock_by_hand import ClockByHand
from replayed_runs import CYCLE_NS, PLAN

from bus_schemas.signals import IMPP
from recordings.read.reader import RecordedMessage
from recordings.replay.clock import PlaybackClock, RecordedSpacing, SimulatedSpacing


def record(cycle: int, publish_time_ns: int) -> RecordedMessage:
    """A message of a cycle."""
    return RecordedMessage(IMPP.of("c1/a"), cycle, 0, publish_time_ns + 9, publish_time_ns, b"")


def test_recorded_spacing_is_that_of_the_publish_times() -> None:
    spacing = RecordedSpacing()
    positions = [spacing.position_ns(record(0, time_ns)) for time_ns in (70, 75, 175)]
    assert [position - positions[0] for position in positions] == [0, 5, 105]


def test_simulated_spacing_gives_each_cycle_its_length_and_keeps_what_is_within() -> None:
    spacing = SimulatedSpacing(PLAN)
    said = [(4, 1_000), (4, 1_300), (5, 1_400), (5, 1_700), (7, 2_000)]
    positions = [spacing.position_ns(record(*entry)) - PLAN.sim_time_ns(4) for entry in said]
    assert positions == [0, 300, CYCLE_NS, CYCLE_NS + 300, 3 * CYCLE_NS]


def test_no_cycle_is_longer_than_it_is_in_simulated_time() -> None:
    spacing = SimulatedSpacing(PLAN)
    spacing.position_ns(record(0, 0))
    assert spacing.position_ns(record(0, 5 * CYCLE_NS)) == PLAN.sim_time_ns(1)


@pytest.mark.parametrize(("rate", "due_ns"), [(1.0, 1_600), (2.0, 1_300), (0.5, 2_200)])
def test_the_rate_is_seconds_on_the_tape_in_a_second(rate: float, due_ns: int) -> None:
    clock = PlaybackClock(rate, now_ns=ClockByHand(1_000))
    clock.move_to(50)
    assert clock.due_ns(50) == 1_000
    assert clock.due_ns(650) == due_ns


def test_at_rate_0_all_is_due() -> None:
    moment = ClockByHand(1_000)
    clock = PlaybackClock(0.0, now_ns=moment)
    assert clock.due_ns(10**18) <= moment()


def test_a_pause_moves_what_comes_after_it() -> None:
    moment = ClockByHand(1_000)
    clock = PlaybackClock(1.0, now_ns=moment)
    clock.move_to(0)
    moment.now_ns += 200
    clock.toggle_pause()
    moment.now_ns += 5_000
    clock.toggle_pause()
    assert clock.due_ns(200) == moment.now_ns
    assert clock.due_ns(260) == moment.now_ns + 60


def test_a_change_of_rate_counts_from_where_the_tape_is() -> None:
    moment = ClockByHand(1_000)
    clock = PlaybackClock(1.0, now_ns=moment)
    clock.move_to(0)
    moment.now_ns += 200
    clock.set_rate(4.0)
    assert clock.due_ns(200) == moment.now_ns
    assert clock.due_ns(600) == moment.now_ns + 100


def test_errors_do_not_add_up_over_a_million_messages() -> None:
    clock = PlaybackClock(3.0, now_ns=ClockByHand(1_000))
    clock.move_to(0)
    assert clock.due_ns(3 * 10**15) == 1_000 + 10**15
