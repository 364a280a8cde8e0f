"""Replays a recording: the bus, the keyboard and the playback together."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TextIO

import msgspec

from launch_scripts.launcher.interruption import interruptible
from recordings.read.reader import RunReader
from recordings.replay.bus import await_subscriber, replay_bus, say, selected_ports
from recordings.replay.clock import CLOCKS, ClockKind, PlaybackClock, default_clock
from recordings.replay.keyboard import KEYS_IN_WORDS, has_keyboard, keyboard
from recordings.replay.playback import Playback, Span
from recordings.replay.progress import ProgressLine
from recordings.replay.timing import TimingFigures


@dataclass(frozen=True, slots=True)
class PlaybackRequest:
    """What is replayed, and how: values of the options of `heliarch replay`.

    `rate` is in seconds of the clock per second; 0: as fast as possible.
    """

    start: str | None = None
    end: str | None = None
    rate: float = 1.0
    clock: ClockKind | None = None
    start_paused: bool = False
    loop: bool = False
    signals: str | None = None
    exclude: str | None = None
    wait: bool = False
    listen: str | None = None


class ReplayFigures(msgspec.Struct, frozen=True):
    """The result of a replay."""

    run_id: str
    recording: str
    messages: int
    cycles: int
    wall_s: float
    rate: float
    clock: ClockKind
    timing_error: TimingFigures | None
    interrupted: bool


def replay_recording(request: PlaybackRequest, reader: RunReader, out: TextIO) -> ReplayFigures:
    """Replay a recording, and print the result."""
    ports = selected_ports(reader.plan, request.signals, request.exclude)
    span = reader.clock.span(request.start, request.end)
    kind = request.clock or default_clock(reader.plan)
    with (
        interruptible() as interruption,
        replay_bus(reader, ports, request.listen, out) as bus,
        keyboard() as keys,
    ):
        say(out, f"clock {kind}: {CLOCKS[kind]}")
        if has_keyboard():
            say(out, KEYS_IN_WORDS)
        playback = Playback(
            reader,
            Span(span.start, None if request.end is None else span.stop),
            ports,
            bus,
            PlaybackClock(request.rate, paused=request.start_paused),
            kind,
            keys,
            interruption,
            ProgressLine(out, reader.clock, reader.last_cycle),
        )
        if request.wait:
            await_subscriber(bus, interruption, out)
        began_at = time.monotonic()
        playback.play(loop=request.loop)
        wall_s = time.monotonic() - began_at
    timing = playback.timing.figures()
    messages, cycles = playback.messages, playback.cycles
    say(out, f"replayed {messages:,} messages of {cycles:,} cycles in {wall_s:.1f} s")
    if timing is not None:
        timing.write(out)
    return ReplayFigures(
        reader.plan.run_id,
        str(reader.path),
        messages,
        cycles,
        wall_s,
        request.rate,
        kind,
        timing,
        bool(interruption),
    )
