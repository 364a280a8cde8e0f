"""Replays a recording: waits until each message is due, publishes it, and obeys the keyboard."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Final, TextIO

from hdrh.histogram import HdrHistogram

from agents.machine import wake_precisely
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.launcher.interruption import Interruption, interruptible
from launch_scripts.launcher.live_view import StatusLine
from recordings.read.reader import RecordedMessage, RunReader
from recordings.replay.bus import ReplayBus, await_subscriber, replay_bus, say
from recordings.replay.clock import ClockKind, PlaybackClock, positions
from recordings.replay.keyboard import (
    DOWN,
    KEYS_IN_WORDS,
    LEFT,
    RIGHT,
    UP,
    Keyboard,
    has_keyboard,
    keyboard,
)
from recordings.replay.publish_order import in_publish_order

_LOOK_S: Final = 0.02
"""How often the keyboard is read."""

_SEEK_S: Final = {LEFT: -10.0, RIGHT: 10.0, DOWN: -60.0, UP: 60.0}
"""How far a key seeks, in simulated time."""

_LATEST_NS: Final = 3_600_000_000_000
"""Greater lateness counts as this."""


def replay_recording(
    reader: RunReader,
    out: TextIO,
    ports: Collection[Port[Message]],
    *,
    start: str | None,
    end: str | None,
    rate: float,
    clock: ClockKind | None,
    start_paused: bool,
    loop: bool,
    wait: bool,
    listen: str | None,
) -> dict[str, Any]:
    """Replay a recording; print the result, and return it for JSON.

    The arguments are the options of the command; `rate` 0: as fast as possible.
    """
    span = reader.clock.span(start, end)
    if end is None:  # The message that ends the run names the cycle after the last one.
        span = range(span.start, span.stop + 1)
    # A lockstep cycle has no length of its own, so only simulated time shows the plant's run.
    kind: ClockKind = clock or ("sim" if reader.plan.lockstep else "wall")
    with (
        interruptible() as interruption,
        replay_bus(reader, ports, listen, out) as bus,
        keyboard() as keys,
    ):
        say(out, f"clock {kind}")
        if has_keyboard():
            say(out, KEYS_IN_WORDS)
        playing = PlaybackClock(rate, paused=start_paused)
        playback = Playback(reader, span, ports, bus, playing, kind, keys, interruption, out)
        if wait:
            await_subscriber(bus, interruption, out)
        began_at = time.monotonic()
        playback.play(loop=loop)
        wall_s = time.monotonic() - began_at
    messages, cycles = playback.messages, playback.cycles
    say(out, f"replayed {messages:,} messages of {cycles:,} cycles in {wall_s:.1f} s")
    return {
        "run_id": reader.plan.run_id,
        "recording": str(reader.path),
        "messages": messages,
        "cycles": cycles,
        "wall_s": wall_s,
        "pace": rate or "max",
        "clock": kind,
        "timing_error": playback.timing_error(),
        "interrupted": bool(interruption),
    }


@dataclass(eq=False)
class Playback:
    """Publishes some cycles, and counts messages and cycles.

    Keeps how late messages were sent, except in steps and at rate 0.
    """

    reader: RunReader
    span: range
    ports: Collection[Port[Message]]
    bus: ReplayBus
    clock: PlaybackClock
    kind: ClockKind
    keyboard: Keyboard
    interruption: Interruption
    out: TextIO
    sleep: Callable[[float], None] = time.sleep

    def __post_init__(self) -> None:
        self.messages = self.cycles = 0
        self._line = StatusLine(self.out, in_place=self.out.isatty())
        self._late = HdrHistogram(1, _LATEST_NS, 3)
        self._quit = False
        self._look_at_ns = self._position_ns = 0
        self._seek(self.span.start)

    def play(self, *, loop: bool = False) -> None:
        wake_precisely()
        self.clock.move_to(self._position_ns)  # A wait for subscribers does not count.
        if self.clock.paused:
            self._announce()
        while not (self._quit or self.interruption):
            if self._next is None and not self.clock.paused:
                if not loop or self._cycle < 0:
                    break
                self._seek(self.span.start)
            elif self._next is not None and self._is_due(self._next):
                self._send(self._next)
                self._turn_to_next()
            self._obey_keys()
        self._show(self._cycle)
        self._line.end()

    def timing_error(self) -> dict[str, float] | None:
        """Print how late messages were sent; return it for JSON, None if it is not known."""
        count = self._late.get_total_count()
        if not count:
            return None
        shares = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}
        late_us = {
            name: self._late.get_value_at_percentile(share) / 1e3 for name, share in shares.items()
        }
        texts = [f"{name} {value:,.0f} µs" for name, value in late_us.items()]
        say(self.out, f"sent later than due: {', '.join(texts)}")
        return {
            "count": count,
            **{f"{name.replace('.', '_')}_us": value for name, value in late_us.items()},
        }

    @property
    def _here(self) -> int:
        """The cycle of the next message; at the end, that of the last one."""
        return self._cycle if self._next is None else self._next.cycle

    def _is_due(self, record: RecordedMessage) -> bool:
        """Whether the next message is due; if not, wait a little."""
        if self.clock.paused:
            return record.cycle <= self._step_to
        left_s = (self.clock.due_ns(self._position_ns) - self.clock.now_ns()) / 1e9
        if left_s > 0.0:
            self.sleep(min(left_s, _LOOK_S))
        return left_s <= 0.0

    def _seek(self, cycle: int) -> None:
        """Let the first message of a cycle be the next one, and be due now."""
        records = in_publish_order(self.reader, self.ports, range(cycle, self.span.stop))
        self._messages = positions(records, self.reader.plan, self.kind)
        self._cycle = self._step_to = -1
        self._turn_to_next()
        self.clock.move_to(self._position_ns)

    def _turn_to_next(self) -> None:
        self._next: RecordedMessage | None
        self._position_ns, self._next = next(self._messages, (self._position_ns, None))

    def _send(self, record: RecordedMessage) -> None:
        if record.cycle > self._cycle:
            self._cycle = record.cycle
            self.cycles += record.cycle <= self.reader.last_cycle
            self._announce()
        was_sent = self.bus.put(record.port, record.payload)
        self.messages += was_sent
        if self.clock.paused:
            self.clock.move_to(self._position_ns)
        elif self.clock.rate and was_sent:
            late_ns = self.clock.now_ns() - self.clock.due_ns(self._position_ns)
            self._late.record_value(min(max(late_ns, 1), _LATEST_NS))

    def _announce(self) -> None:
        if self._next is not None:
            clock = self.clock
            self.bus.announce(self._next.cycle, rate=clock.rate, paused=clock.paused)

    def _obey_keys(self) -> None:
        """Read the keyboard if it is time to, and do what a key asks for."""
        clock, key = self.clock, ""
        # A step ends at the first message of a later cycle.
        if self._next is not None and self._next.cycle <= self._step_to:
            return
        if clock.paused:
            key = self.keyboard(_LOOK_S)
        elif clock.now_ns() >= self._look_at_ns:
            self._look_at_ns = clock.now_ns() + round(_LOOK_S * 1e9)
            key = self.keyboard(0.0)
            if self._line.is_due():
                self._show(self._cycle)
        if key:
            self._do(key)
            self._announce()
            self._show(self._here)

    def _do(self, key: str) -> None:
        match key:
            case "s" if self.clock.paused:
                self._step_to = self._here
            case " " | "s":
                self.clock.toggle_pause()
            case "+" | "=":  # The same key, with and without shift.
                self.clock.set_rate(self.clock.rate * 2.0)
            case "-":
                self.clock.set_rate(self.clock.rate / 2.0)
            case "q":
                self._quit = True
            case arrow if arrow in _SEEK_S:
                self._seek_by(_SEEK_S[arrow])

    def _seek_by(self, seconds: float) -> None:
        """Go forward or back by a simulated time, at least a cycle, within the span."""
        cycles = round(seconds * 1e9 / self.reader.plan.cycle_ns)
        cycles = cycles or (1 if seconds > 0.0 else -1)
        last = min(self.span.stop - 1, self.reader.last_cycle)
        self._seek(min(max(self._here + cycles, self.span.start), last))

    def _show(self, cycle: int) -> None:
        if cycle >= 0:
            rate = f"pace {self.clock.rate:g}" if self.clock.rate else "as fast as possible"
            paused = " paused" if self.clock.paused else ""
            last = self.reader.last_cycle
            cycle = min(cycle, last)
            place = f"{self.reader.clock.text(cycle)} cycle {cycle} of 0 to {last}"
            self._line.show(f"{place}, {rate}{paused}")
