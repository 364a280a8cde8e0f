"""Replays a recording: waits until each message is due, publishes it, and obeys the keyboard."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Final, Protocol, TextIO

from agents.process.interruption import Interruption, interruptible
from agents.process.machine import wake_precisely
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.read.reader import RecordedMessage, RunReader
from recordings.replay.bus import ReplayBus, await_subscriber, replay_bus, say
from recordings.replay.keyboard import KEYS_IN_WORDS, Keyboard, has_keyboard, keyboard
from recordings.replay.schedule import PlaybackClock, in_publish_order, positions

_LOOK_S: Final = 0.02
"""How often the keyboard is read."""


class StatusLine(Protocol):
    """Where the user reads how far a replay has come."""

    def is_due(self) -> bool: ...

    def show(self, text: str) -> None: ...

    def end(self) -> None: ...


@dataclass(frozen=True)
class ReplayOptions:
    """The options of the command. `rate` 0: as fast as possible."""

    start: str | None = None
    end: str | None = None
    rate: float = 1.0
    start_paused: bool = False
    loop: bool = False
    wait: bool = False
    listen: str | None = None


def replay_recording(
    reader: RunReader,
    out: TextIO,
    line: StatusLine,
    ports: Collection[Port[Message]],
    options: ReplayOptions,
) -> dict[str, Any]:
    """Replay a recording; print the result, and return it for JSON."""
    span = reader.clock.span(options.start, options.end)
    if options.end is None:  # The message that ends the run names the cycle after the last one.
        span = range(span.start, span.stop + 1)
    with (
        interruptible() as interruption,
        replay_bus(reader, ports, options.listen, out) as bus,
        keyboard() as keys,
    ):
        if has_keyboard():
            say(out, KEYS_IN_WORDS)
        clock = PlaybackClock(options.rate, paused=options.start_paused)
        playback = Playback(reader, ports, span, bus, clock, keys, interruption, line)
        if options.wait:
            await_subscriber(bus, interruption, out)
        began_at = time.monotonic()
        playback.play(loop=options.loop)
        wall_s = time.monotonic() - began_at
    messages, cycles, latest_us = playback.messages, playback.cycles, playback.latest_us
    say(out, f"replayed {messages:,} messages of {cycles:,} cycles in {wall_s:.1f} s")
    if latest_us is not None:
        say(out, f"sent at most {latest_us:,.0f} µs later than due")
    return {
        "run_id": reader.plan.run_id,
        "recording": str(reader.path),
        "messages": messages,
        "cycles": cycles,
        "wall_s": wall_s,
        "pace": options.rate or "max",
        "latest_us": latest_us,
        "interrupted": bool(interruption),
    }


@dataclass(eq=False)
class Playback:
    """Sends the messages of some cycles when they are due. At rate 0 nothing has a due time.

    messages, cycles: How many were sent. latest_us: At most how late [µs]; None: nothing was due.
    """

    reader: RunReader
    ports: Collection[Port[Message]]
    span: range
    bus: ReplayBus
    clock: PlaybackClock
    keyboard: Keyboard
    interruption: Interruption
    line: StatusLine
    messages: int = 0
    cycles: int = 0
    latest_us: float | None = None

    def __post_init__(self) -> None:
        self._cycle = -1
        self._look_at_ns = 0

    def play(self, *, loop: bool = False) -> None:
        """Send all messages; begin again at the end if it is a loop."""
        wake_precisely()
        goes_on = True
        while goes_on:
            self._cycle = -1
            goes_on = self._play_once() and loop and self._cycle >= 0
        self._show()
        self.line.end()

    def _play_once(self) -> bool:
        """Send all messages; return whether the user has let it come to the end."""
        records = in_publish_order(self.reader, self.ports, self.span)
        is_first = True
        for position_ns, record in positions(records, self.reader.plan):
            if is_first:
                self.clock.move_to(position_ns)  # A wait for subscribers does not count.
                if self.clock.paused:
                    self._announce(record)
            is_first = False
            while not self._is_due(position_ns):
                if not self._goes_on(record):
                    return False
            self._send(record, position_ns)
            if not self._goes_on(record):
                return False
        return True

    def _is_due(self, position_ns: int) -> bool:
        """Whether the next message is due; if not, wait a little."""
        if self.clock.paused:
            return False
        left_s = (self.clock.due_ns(position_ns) - self.clock.now_ns()) / 1e9
        if left_s > 0.0:
            self.clock.sleep(min(left_s, _LOOK_S))
        return left_s <= 0.0

    def _send(self, record: RecordedMessage, position_ns: int) -> None:
        if record.cycle > self._cycle:
            self._cycle = record.cycle
            self.cycles += record.cycle <= self.reader.last_cycle
            self._announce(record)
        was_sent = self.bus.put(record.port, record.payload)
        self.messages += was_sent
        if self.clock.rate and was_sent:
            late_ns = self.clock.now_ns() - self.clock.due_ns(position_ns)
            self.latest_us = max(late_ns / 1e3, self.latest_us or 0.0)

    def _announce(self, record: RecordedMessage) -> None:
        self.bus.announce(record.cycle, rate=self.clock.rate, paused=self.clock.paused)

    def _goes_on(self, record: RecordedMessage) -> bool:
        """Do what a key asks for, if it is time to look; return whether the user lets it go on."""
        clock, key = self.clock, ""
        if clock.paused:
            key = self.keyboard(_LOOK_S)
        elif clock.now_ns() >= self._look_at_ns:
            self._look_at_ns = clock.now_ns() + round(_LOOK_S * 1e9)
            key = self.keyboard(0.0)
            if self.line.is_due():
                self._show()
        if key == " ":
            clock.toggle_pause()
            self._announce(record)
            self._show()
        return key != "q" and not self.interruption

    def _show(self) -> None:
        if self._cycle >= 0:
            rate = f"pace {self.clock.rate:g}" if self.clock.rate else "as fast as possible"
            paused = " paused" if self.clock.paused else ""
            last_cycle, clock = self.reader.last_cycle, self.reader.clock
            cycle = min(self._cycle, last_cycle)
            at = f"{clock.text(cycle)} cycle {cycle} of 0 to {last_cycle}"
            self.line.show(f"{at}, {rate}{paused}")
