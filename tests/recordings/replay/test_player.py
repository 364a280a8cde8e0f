"""A player sends what is due in its order, and does what keys ask for."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from clock_by_hand import ClockByHand
from recordings.replay.player import Player, Span
from recordings.replay.recorded_run import RecordedRun
from recordings.replay.selection import Selection, select
from replayed_runs import PLAN, Said, run_in_memory, write

from bus_schemas.codec import encode
from bus_schemas.messages import Clock
from launch_scripts.launcher.interruption import Interruption
from recordings.replay.clock import PlaybackClock, RecordedSpacing
from recordings.replay.keyboard import Key
from recordings.replay.progress import ProgressLine

SAID = run_in_memory()
ALL = Span(0, None)


class Heard:
    """What went out: payloads, and the words about where the replay stands."""

    def __init__(self, on_put: Callable[[Heard], None] = lambda heard: None) -> None:
        self.clock = ClockByHand()
        self.payloads: list[bytes] = []
        self.keys: list[str] = []
        self.clocks: list[Clock] = []
        self.moments_ns: list[int] = []
        self._on_put = on_put

    def put(self, key: str, payload: bytes) -> None:
        self.payloads.append(payload)
        self.keys.append(key)
        self.moments_ns.append(self.clock.now_ns)
        self._on_put(self)

    def announce(self, clock: Clock) -> None:
        self.clocks.append(clock)

    @property
    def cycles(self) -> list[int]:
        """The cycles that were announced, one after the other."""
        return [clock.cycle for clock in self.clocks]


class Hands:
    """Keys that are pressed one look after the other, with what was heard at each."""

    def __init__(self, heard: Heard, *keys: Key | None) -> None:
        self.heard_at_keys: list[int] = []
        self._heard = heard
        self._keys = list(keys)

    def wait(self, seconds: float) -> list[Key]:
        self.heard_at_keys.append(len(self._heard.payloads))
        key = self._keys.pop(0) if self._keys else Key.QUIT
        return [] if key is None else [key]


class NoHands:
    """Nobody presses a key."""

    def wait(self, seconds: float) -> list[Key]:
        assert seconds == 0.0, "a recorded that plays does not stop to look at the keyboard"
        return []


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 40 cycles."""
    return write(tmp_path_factory.mktemp("player") / "run", SAID)


@contextmanager
def player(
    recorded: Path,
    heard: Heard,
    *,
    span: Span = ALL,
    rate: float = 0.0,
    paused: bool = False,
    hands: Hands | NoHands | None = None,
    selection: Selection | None = None,
    interruption: Interruption | None = None,
) -> Iterator[Player]:
    """A player of the recording, as fast as possible, on the clock of who hears it."""
    with RecordedRun(recorded) as run:
        yield Player(
            run,
            span,
            selection or select(PLAN),
            heard,
            PlaybackClock(rate, paused=paused, now_ns=heard.clock),
            RecordedSpacing,
            hands or NoHands(),
            Interruption() if interruption is None else interruption,
            ProgressLine(io.StringIO(), PLAN),
            heard.clock.sleep,
        )


def payloads(said: list[Said], first: int = 0, before: int = 1000) -> list[bytes]:
    """What was on the wire in some cycles."""
    return [encode(entry.message) for entry in said if first <= entry.message.cycle < before]


def step(first: int, cycle: int | None = None) -> list[bytes]:
    """What goes out up to a cycle's end, from the beginning of another one (the same by default).

    One agent may be ahead of another: a cycle ends, for a step, where the first message of a later
    one comes.
    """
    last = first if cycle is None else cycle
    sent = []
    for entry in SAID:
        if entry.message.cycle > last:
            break
        if entry.message.cycle >= first:
            sent.append(encode(entry.message))
    return sent


def test_all_bytes_go_out_on_their_keys_in_their_order(recorded: Path) -> None:
    heard = Heard()
    with player(recorded, heard) as played:
        played.play()
    assert heard.payloads == payloads(SAID)
    assert heard.keys == [PLAN.keys.key(entry.port) for entry in SAID]
    assert (played.played.messages, played.played.cycles) == (len(SAID), 40)
    assert played.played.timing.figures() is None  # as fast as possible: nothing is due


def test_each_cycle_is_announced_with_its_simulated_time(recorded: Path) -> None:
    heard = Heard()
    with player(recorded, heard) as played:
        played.play()
    assert heard.cycles == list(range(41))  # the last word of a run is said after its last cycle
    assert [clock.sim_time_ns for clock in heard.clocks] == [PLAN.sim_time_ns(c) for c in range(41)]
    assert {(clock.rate, clock.paused, clock.source) for clock in heard.clocks} == {
        (0.0, False, "replayer")
    }


def test_a_span_is_played_alone(recorded: Path) -> None:
    heard = Heard()
    with player(recorded, heard, span=Span(5, 9)) as played:
        played.play()
    assert heard.payloads == payloads(SAID, 5, 9)


def test_a_loop_begins_again_until_the_user_ends_it(recorded: Path) -> None:
    interruption = Interruption()
    length = len(payloads(SAID, 5, 9))

    def end_in_the_third_round(heard: Heard) -> None:
        if len(heard.payloads) == 2 * length + 3:
            interruption.count = 1

    heard = Heard(end_in_the_third_round)
    with player(recorded, heard, span=Span(5, 9), interruption=interruption) as played:
        played.play(loop=True)
    once = payloads(SAID, 5, 9)
    assert heard.payloads == once + once + once[:3]


def due_at_a_quarter(first: int, before: int, began_ns: int) -> list[int]:
    """When messages of some cycles are due at a quarter of the rate at which they were said."""
    said_ns = [
        entry.message.publish_time_ns for entry in SAID if first <= entry.message.cycle < before
    ]
    return [began_ns + 4 * (time_ns - said_ns[0]) for time_ns in said_ns]


def test_each_message_is_sent_when_it_is_due_and_all_is_timed(recorded: Path) -> None:
    heard = Heard()
    with player(recorded, heard, span=Span(5, 9), rate=0.25) as played:
        played.play()
    due_ns = due_at_a_quarter(5, 9, heard.moments_ns[0])
    assert heard.moments_ns == due_ns
    figures = played.played.timing.figures()
    assert figures is not None
    assert figures.count == len(due_ns)
    assert figures.max_us < 1.0


def test_what_a_stall_delayed_goes_out_at_once_and_later_messages_are_in_time_again(
    recorded: Path,
) -> None:
    stall_ns, stalled_at = 50 * 10**6, 10

    def stall(heard: Heard) -> None:
        if len(heard.payloads) == stalled_at + 1:
            heard.clock.now_ns += stall_ns

    heard = Heard(stall)
    with player(recorded, heard, span=Span(0, 12), rate=0.25) as played:
        played.play()
    due_ns = due_at_a_quarter(0, 12, heard.moments_ns[0])
    goes_on_ns = due_ns[stalled_at] + stall_ns
    delayed = [max(due, goes_on_ns) for due in due_ns[stalled_at + 1 :]]
    assert heard.moments_ns == due_ns[: stalled_at + 1] + delayed
    assert delayed[-1] == due_ns[-1]
    # The one that took so long to send is late by all of it.
    figures = played.played.timing.figures()
    assert figures is not None
    assert figures.max_us == pytest.approx(stall_ns / 1e3, rel=0.01)


def test_while_it_is_paused_nothing_goes_out_but_the_word_that_it_is(recorded: Path) -> None:
    heard = Heard()
    hands = Hands(heard, None, None, None, Key.QUIT)
    with player(recorded, heard, paused=True, hands=hands) as played:
        played.play()
    assert heard.payloads == []
    assert heard.clocks[0].paused
    assert heard.clocks[0].cycle == 0


def test_a_step_sends_one_cycle(recorded: Path) -> None:
    heard = Heard()
    hands = Hands(heard, Key.STEP, None, Key.STEP, Key.STEP, Key.QUIT)
    with player(recorded, heard, paused=True, hands=hands, rate=1.0) as played:
        played.play()
    ends = [0, *(len(step(0, cycle)) for cycle in (0, 0, 1, 2))]
    assert hands.heard_at_keys == ends
    assert heard.payloads == step(0, 2)
    assert played.played.timing.figures() is None  # a step has no due time


def test_space_goes_on_from_where_it_stands(recorded: Path) -> None:
    heard = Heard()
    hands = Hands(heard, Key.STEP, Key.STEP, Key.PAUSE, *[None] * 10_000)
    with player(recorded, heard, paused=True, hands=hands) as played:
        played.play()
    assert heard.payloads == payloads(SAID)
    assert not heard.clocks[-1].paused


@pytest.mark.parametrize(
    ("key", "lands_at"),
    [(Key.FORWARD, 12), (Key.FAR_FORWARD, 39), (Key.BACK, 0), (Key.FAR_BACK, 0)],
)
def test_arrows_seek_by_simulated_time_within_the_run(
    recorded: Path, key: Key, lands_at: int
) -> None:
    heard = Heard()
    hands = Hands(heard, Key.STEP, Key.STEP, key, Key.STEP, Key.QUIT)
    with player(recorded, heard, paused=True, hands=hands) as played:
        played.play()
    assert heard.payloads == step(0, 1) + step(lands_at)
    assert heard.cycles[-1] in {lands_at, lands_at + 1}


def test_arrows_stay_within_the_span(recorded: Path) -> None:
    heard = Heard()
    hands = Hands(heard, Key.FAR_FORWARD, Key.STEP, Key.FAR_BACK, Key.STEP, Key.QUIT)
    with player(recorded, heard, span=Span(5, 9), paused=True, hands=hands) as played:
        played.play()
    assert heard.payloads == payloads(SAID, 8, 9) + step(5)


def test_one_who_has_stepped_to_the_end_may_go_back(recorded: Path) -> None:
    heard = Heard()
    hands = Hands(heard, Key.STEP, Key.STEP, Key.BACK, Key.STEP, Key.QUIT)
    with player(recorded, heard, span=Span(30, 31), paused=True, hands=hands) as played:
        played.play()
    assert heard.payloads == payloads(SAID, 30, 31) * 2


def test_plus_and_minus_change_the_rate_and_say_so(recorded: Path) -> None:
    heard = Heard()
    hands = Hands(heard, Key.FASTER, Key.FASTER, Key.SLOWER, Key.STEP, Key.QUIT)
    with player(recorded, heard, paused=True, hands=hands, rate=1.0) as played:
        played.play()
    assert [clock.rate for clock in heard.clocks[:4]] == [1.0, 2.0, 4.0, 2.0]


def test_as_fast_as_possible_stays_so(recorded: Path) -> None:
    heard = Heard()
    hands = Hands(heard, Key.FASTER, Key.SLOWER, Key.QUIT)
    with player(recorded, heard, paused=True, hands=hands) as played:
        played.play()
    assert {clock.rate for clock in heard.clocks} == {0.0}
