"""Replays a recording: waits until each message is due, and publishes it."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Final, TextIO

from agents.process.interruption import Interruption, interruptible
from agents.process.machine import wake_precisely
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.read.reader import RecordedMessage, RunReader
from recordings.replay.beside import replay_beside
from recordings.replay.bus import (
    ReplayBus,
    ReplayOptions,
    StatusLine,
    await_subscriber,
    replay_bus,
    say,
)
from recordings.replay.schedule import in_publish_order, positions

_LOOK_S: Final = 0.02
"""How often Ctrl-C is looked for."""


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
    with interruptible() as interruption, ExitStack() as stack:
        beside = None
        if options.without is None:
            bus = stack.enter_context(replay_bus(reader, ports, options.listen, out))
        else:
            if not reader.plan.timing.lockstep and options.rate != 1.0:
                raise InputError("--pace: expected 1: agents beside the replay have deadlines")
            bus = beside = stack.enter_context(
                replay_beside(reader, options, interruption, out, line)
            )
        playback = Playback(reader, ports, span, bus, options.rate, interruption, line)
        if options.wait:
            await_subscriber(bus, interruption, out)
        began_at = time.monotonic()
        playback.play(loop=options.loop)
        if beside is not None:
            beside.finish()
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
    rate: float
    interruption: Interruption
    line: StatusLine
    messages: int = 0
    cycles: int = 0
    latest_us: float | None = None
    now_ns: Callable[[], int] = time.monotonic_ns
    sleep: Callable[[float], None] = time.sleep

    def __post_init__(self) -> None:
        self._cycle, self._anchor_ns = -1, (0, 0)

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
                self._anchor_ns = position_ns, self.now_ns()
            is_first = False
            while not self._is_due(position_ns):
                if self.interruption:
                    return False
            self._send(record, position_ns)
            if self.line.is_due():
                self._show()
            if self.interruption:
                return False
        return True

    def _is_due(self, position_ns: int) -> bool:
        """Whether the next message is due; if not, wait a little."""
        left_s = (self._due_ns(position_ns) - self.now_ns()) / 1e9
        if left_s > 0.0:
            self.sleep(min(left_s, _LOOK_S))
        return left_s <= 0.0

    def _due_ns(self, position_ns: int) -> int:
        """Return when a position is reached, counted from the first message."""
        began_ns, at_ns = self._anchor_ns
        return at_ns + round((position_ns - began_ns) / self.rate) if self.rate else at_ns

    def _send(self, record: RecordedMessage, position_ns: int) -> None:
        if record.cycle > self._cycle:
            self._cycle = record.cycle
            self.cycles += record.cycle <= self.reader.last_cycle
            self.bus.announce(record.cycle, rate=self.rate)
        was_sent = self.bus.put(record.port, record.payload)
        self.messages += was_sent
        if self.rate and was_sent:
            late_ns = self.now_ns() - self._due_ns(position_ns)
            self.latest_us = max(late_ns / 1e3, self.latest_us or 0.0)

    def _show(self) -> None:
        if self._cycle >= 0:
            rate = f"pace {self.rate:g}" if self.rate else "as fast as possible"
            last_cycle, clock = self.reader.last_cycle, self.reader.clock
            cycle = min(self._cycle, last_cycle)
            at = f"{clock.text(cycle)} cycle {cycle} of 0 to {last_cycle}"
            self.line.show(f"{at}, {rate}")
