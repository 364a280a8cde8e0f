"""When messages are due: their positions, the rate, pauses."""

from __future__ import annotations

import pytest
from clock_by_hand import ClockByHand
from replayed_runs import CYCLE_NS, PLAN

from bus_schemas.signals import IMPP
from recordings.read.reader import RecordedMessage
from recordings.replay.clock import ClockKind, PlaybackClock, Positions

PUBLISHED = [(4, 1_000), (4, 1_300), (5, 1_400), (4, 1_350), (5, 1_700), (7, 2_000), (7, 3 * 10**9)]


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("wall", [0, 300, 400, 400, 700, 1_000, 3 * 10**9 - 1_000]),
        ("sim", [0, 300, CYCLE_NS, CYCLE_NS, CYCLE_NS + 300, 3 * CYCLE_NS, 4 * CYCLE_NS]),
    ],
)
def test_the_clock_says_how_far_messages_are_apart(kind: ClockKind, expected: list[int]) -> None:
    positions = Positions(PLAN, kind)
    found = [
        positions.next(RecordedMessage(IMPP.of("c1/a"), cycle, 0, time_ns, time_ns, b""))
        for cycle, time_ns in PUBLISHED
    ]
    assert [position - found[0] for position in found] == expected


@pytest.mark.parametrize(("rate", "due_ns"), [(1.0, 1_600), (2.0, 1_300), (0.5, 2_200), (0, 1_000)])
def test_the_rate_is_in_seconds_of_the_clock_per_second(rate: float, due_ns: int) -> None:
    clock = PlaybackClock(rate, now_ns=ClockByHand(1_000))
    clock.move_to(50)
    assert clock.due_ns(50) == 1_000
    assert clock.due_ns(650) == due_ns


def test_pauses_and_changes_of_rate_count_from_where_the_clock_is() -> None:
    moment = ClockByHand(1_000)
    clock = PlaybackClock(1.0, now_ns=moment)
    clock.move_to(0)
    moment.now_ns += 200
    clock.toggle_pause()
    moment.now_ns += 5_000
    clock.toggle_pause()
    assert clock.due_ns(200) == moment.now_ns
    clock.set_rate(4.0)
    assert clock.due_ns(600) == moment.now_ns + 100


def test_errors_do_not_add_up_over_a_million_messages() -> None:
    clock = PlaybackClock(3.0, now_ns=ClockByHand(1_000))
    clock.move_to(0)
    assert clock.due_ns(3 * 10**15) == 1_000 + 10**15
