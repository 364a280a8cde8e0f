"""Plays a recording: waits until each message is due, sends it, and heeds the keyboard."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

from agents.machine import wake_precisely
from bus_schemas.messages import Clock
from bus_schemas.tree import REPLAYER
from launch_scripts.launcher.interruption import Interruption
from recordings.read.reader import RecordedMessage
from recordings.replay.clock import PlaybackClock, Spacing
from recordings.replay.figures import TimingErrors
from recordings.replay.keyboard import Key, Keyboard
from recordings.replay.progress import ProgressLine
from recordings.replay.recorded_run import RecordedRun
from recordings.replay.selection import Selection

_LOOK_S: Final = 0.02
"""How often the keyboard is looked at."""

_FASTEST: Final = 1024.0
_SLOWEST: Final = 1.0 / 1024.0

_SEEK_S: Final = {
    Key.BACK: -10.0,
    Key.FORWARD: 10.0,
    Key.FAR_BACK: -60.0,
    Key.FAR_FORWARD: 60.0,
}
"""How far a key goes, in simulated time."""


class Sink(Protocol):
    """Where messages go."""

    def put(self, key: str, payload: bytes) -> None:
        """Send bytes."""

    def announce(self, clock: Clock) -> None:
        """Tell where the replay stands."""


class Span(NamedTuple):
    """The part of a run that is replayed: from the first cycle to just before the other."""

    first_cycle: int
    before_cycle: int | None


@dataclass
class Played:
    """What has been replayed.

    Attributes
    ----------
    messages, cycles
        How many messages went out, and how many times a cycle began.
    timing
        Errors of what had a due time: not of steps, nor at rate 0.
    """

    messages: int
    cycles: int
    timing: TimingErrors


class Player:
    """Plays a recording onto the bus.

    Parameters
    ----------
    recorded
        The recording.
    span
        The part of it.
    selection
        What of it goes out, and on which keys.
    sink
        Where it goes.
    clock
        Rate and pause.
    spacing
        Makes what says how far messages are apart, anew after each seek.
    keyboard
        Steers it.
    interruption
        Ends it.
    progress
        Shows it.
    sleep
        Waits for so many seconds of the clock.
    """

    def __init__(
        self,
        recorded: RecordedRun,
        span: Span,
        selection: Selection,
        sink: Sink,
        clock: PlaybackClock,
        spacing: Callable[[], Spacing],
        keyboard: Keyboard,
        interruption: Interruption,
        progress: ProgressLine,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.played = Played(0, 0, TimingErrors())
        self._recorded = recorded
        self._span = span
        self._key_of = selection.key_of
        self._sink = sink
        self._clock = clock
        self._make_spacing = spacing
        self._keyboard = keyboard
        self._interruption = interruption
        self._progress = progress
        self._sleep = sleep
        self._quit = False
        self._look_at_ns = 0
        self._step_to = -1
        self._records: Iterator[RecordedMessage] = iter(())
        self._next: RecordedMessage | None = None
        self._spacing = spacing()
        self._position_ns = 0
        self._cycle = -1

    def play(self, *, loop: bool = False) -> None:
        """Play the span once, or again and again until the user ends it."""
        wake_precisely()
        self._seek(self._span.first_cycle)
        if self._clock.paused and self._next is not None:
            self._announce(self._next)
        while self._next is not None:
            self._play_to_the_end()
            if self._over or not loop:
                return
            self._seek(self._span.first_cycle)

    @property
    def _over(self) -> bool:
        return self._quit or bool(self._interruption)

    def _play_to_the_end(self) -> None:
        while not self._over:
            record = self._next
            if record is None and not self._clock.paused:
                return
            if record is None:  # Stepped up to the end: one may still go back.
                self._heed(self._keyboard.wait(_LOOK_S))
            elif self._await(record):
                self._send(record)
                self._turn_to(next(self._records, None))

    def _seek(self, cycle: int) -> None:
        """Let the first message of a cycle be the next one, and be due now."""
        self._records = self._recorded.records(self._key_of.keys(), cycle, self._span.before_cycle)
        self._spacing = self._make_spacing()
        self._cycle = self._step_to = -1
        self._position_ns = -(1 << 62)
        self._turn_to(next(self._records, None))
        self._clock.move_to(self._position_ns)

    def _turn_to(self, record: RecordedMessage | None) -> None:
        self._next = record
        if record is not None:
            # The order of the recorded holds, whatever the spacing makes of a straggler.
            self._position_ns = max(self._position_ns, self._spacing.position_ns(record))

    def _await(self, record: RecordedMessage) -> bool:
        """Wait until a message is due. False: the user ended the replay, or sought another one."""
        while not self._over:
            if self._clock.paused:
                if record.cycle <= self._step_to:
                    return True
                self._heed(self._keyboard.wait(_LOOK_S))
            elif self._keys_can_wait():
                left_s = (self._clock.due_ns(self._position_ns) - self._clock.now_ns()) / 1e9
                if left_s <= 0.0:
                    return True
                self._sleep(min(left_s, _LOOK_S))
            if self._next is not record:
                return False
        return False

    def _keys_can_wait(self) -> bool:
        """Look at the keyboard if it is time to; return whether it was not."""
        now_ns = self._clock.now_ns()
        if now_ns < self._look_at_ns:
            return True
        self._look_at_ns = now_ns + round(_LOOK_S * 1e9)
        self._heed(self._keyboard.wait(0.0))
        self._progress.show(self._cycle, self._clock)
        return False

    def _send(self, record: RecordedMessage) -> None:
        if record.cycle > self._cycle:
            self._cycle = record.cycle
            self.played.cycles += record.cycle < self._recorded.cycles  # the end lies in none
            self._announce(record)
        self._sink.put(self._key_of[record.port], record.payload)
        self.played.messages += 1
        if self._clock.paused:
            self._clock.move_to(self._position_ns)
        elif self._clock.rate:
            late_ns = self._clock.now_ns() - self._clock.due_ns(self._position_ns)
            self.played.timing.add(late_ns)

    def _announce(self, record: RecordedMessage) -> None:
        self._sink.announce(
            Clock(
                record.cycle,
                self._recorded.plan.sim_time_ns(record.cycle),
                REPLAYER,
                (),
                rate=self._clock.rate,
                paused=self._clock.paused,
            )
        )

    def _heed(self, keys: list[Key]) -> None:
        for key in keys:
            self._do(key)
        if keys and self._next is not None:
            self._announce(self._next)
            self._progress.show(max(self._cycle, self._next.cycle), self._clock, now=True)

    def _do(self, key: Key) -> None:
        match key:
            case Key.PAUSE:
                self._clock.toggle_pause()
            case Key.STEP if self._clock.paused:
                self._step_to = self._next.cycle if self._next is not None else -1
            case Key.STEP:
                self._clock.toggle_pause()
            case Key.FASTER | Key.SLOWER:
                self._clock.set_rate(_next_rate(self._clock.rate, faster=key is Key.FASTER))
            case Key.QUIT:
                self._quit = True
            case _:
                self._seek_by(_SEEK_S[key])

    def _seek_by(self, seconds: float) -> None:
        """Go on or back by a simulated time, at least a cycle, within the span."""
        cycles = round(seconds * 1e9 / self._recorded.plan.cycle_ns)
        cycles = cycles or (1 if seconds > 0.0 else -1)
        here = self._next.cycle if self._next is not None else self._cycle
        last = (self._span.before_cycle or self._recorded.cycles) - 1
        self._seek(min(max(here + cycles, self._span.first_cycle), last))


def _next_rate(rate: float, *, faster: bool) -> float:
    """Twice or half the rate; as fast as possible (0) stays what it is."""
    if rate == 0.0:
        return 0.0
    return min(rate * 2.0, _FASTEST) if faster else max(rate / 2.0, _SLOWEST)
