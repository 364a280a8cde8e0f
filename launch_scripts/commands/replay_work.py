"""`heliarch replay`: from the arguments to an exit status."""

from __future__ import annotations

import sys
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO, cast

import msgspec

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import CLOCK, SIGNALS, Port
from bus_schemas.tree import REPLAYER, ROOT
from launch_scripts.commands.replay_request import ReplayRequest, check_request, requested_span
from launch_scripts.exit_status import BAD_INPUT, FAILED, INTERRUPTED, OK, complain
from launch_scripts.launcher.interruption import Interruption, interruptible
from launch_scripts.launcher.supervision import RunFailure
from launch_scripts.launcher.tcp_ports import reserved_ports
from recordings.read.reader import RunReader
from recordings.read.selection import find_signals
from recordings.replay.bus import ReplayBus
from recordings.replay.clock import CLOCKS, ClockKind, PlaybackClock, default_clock
from recordings.replay.keyboard import KEYS_IN_WORDS, has_keyboard, keyboard
from recordings.replay.playback import Playback
from recordings.replay.progress import ProgressLine
from recordings.replay.timing import TimingFigures


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


def replay(request: ReplayRequest) -> int:
    """Replay a recording and print the result. Returns the exit status."""
    from launch_scripts.commands.replay_live import replay_live  # noqa: PLC0415 - it imports us

    out = sys.stderr if request.json == "-" else sys.stdout
    try:
        check_request(request)
        with RunReader(request.run) as reader:
            if request.live is not None:
                return replay_live(request, reader, out)
            return _replay(request, reader, out)
    except InputError as error:
        return complain(error, BAD_INPUT)
    except RunFailure as error:
        return complain(error, FAILED)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)


def _replay(request: ReplayRequest, reader: RunReader, out: TextIO) -> int:
    ports = selected_ports(reader.plan, request.signals, request.exclude)
    span = requested_span(request, reader)
    kind = cast(ClockKind, request.clock or default_clock(reader.plan))
    introduce(reader, out)
    say(out, f"clock {kind}: {CLOCKS[kind]}")
    with (
        interruptible() as interruption,
        replay_bus(reader.plan, ports, request.listen, out) as bus,
        keyboard() as keys,
    ):
        if has_keyboard():
            say(out, KEYS_IN_WORDS)
        playback = Playback(
            reader,
            span,
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
    figures = ReplayFigures(
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
    write_json(figures, request.json)
    return INTERRUPTED if interruption else OK


def selected_ports(
    plan: RunPlan, signals: str | None = None, exclude: str | None = None
) -> tuple[Port[Message], ...]:
    """Return the ports that are replayed: by default the recorded ones, and the replay's clock."""
    excluded = _names(exclude)
    left_out = {*find_signals(name for name in excluded if name != CLOCK.name)}
    kept = find_signals(_names(signals)) or tuple(signal for signal in SIGNALS if signal.logged)
    ports = [
        port for port in plan.keys.ports if port.signal in kept and port.signal not in left_out
    ]
    if not ports:
        raise InputError("--exclude: expected some signal to be left, got none")
    return tuple(ports) if CLOCK.name in excluded else (*ports, CLOCK.of(ROOT))


def introduce(reader: RunReader, out: TextIO) -> None:
    """Print which run is replayed."""
    say(out, f"{reader.plan.run_id}, {reader.clock.extent()}")
    if not reader.whole:
        say(out, "cut short: replayed up to the cut (`heliarch recover` makes a whole file)")


@contextmanager
def replay_bus(
    plan: RunPlan, ports: Collection[Port[Message]], listen: str | None, out: TextIO
) -> Iterator[ReplayBus]:
    """Join the bus, at an address or at a free port of 127.0.0.1; print how to subscribe."""
    with reserved_ports((REPLAYER,)) as tcp_ports:
        endpoint = listen or f"tcp/127.0.0.1:{tcp_ports[REPLAYER]}"
        with ReplayBus(plan, ports, endpoint) as bus:
            say(out, f"endpoint {endpoint}\nkeys {plan.run_id}/{plan.plant}/**")
            yield bus


def await_subscriber(bus: ReplayBus, interruption: Interruption, out: TextIO) -> None:
    """Wait until somebody subscribes, or the user asks for an end."""
    say(out, "waiting for a subscriber")
    while not interruption and not bus.has_subscriber:
        interruption.wait(0.05)


def say(out: TextIO, text: str) -> None:
    """Print a line at once."""
    out.write(f"{text}\n")
    out.flush()


def write_json(figures: msgspec.Struct, json: str | None) -> None:
    """Write figures to a file, or to standard output (`-`), if the user wants them."""
    document = msgspec.json.format(msgspec.json.encode(figures), indent=1)
    if json == "-":
        sys.stdout.write(document.decode() + "\n")
    elif json is not None:
        Path(json).write_bytes(document + b"\n")


def _names(text: str | None) -> list[str]:
    return [] if text is None else [name.strip() for name in text.split(",")]
