"""The arguments of `heliarch replay`, checked."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from math import ceil
from pathlib import Path
from typing import Final

from bus_schemas.errors import InputError
from launch_scripts.launcher.json_rows import check_json_destination
from launch_scripts.scenarios.scenario import parse_duration_s
from recordings.read.reader import RunReader
from recordings.replay.clock import CLOCKS
from recordings.replay.keyboard import has_keyboard
from recordings.replay.playback import Span

_FASTEST_RATE: Final = 1000.0
_ENDPOINT: Final = re.compile(r"tcp/[^/\s#?]+:\d{1,5}")

_NOT_LIVE: Final = {
    "rate": "--rate",
    "clock": "--clock",
    "start_offset": "--from",
    "start_paused": "--start-paused",
    "loop": "--loop",
    "signals": "--signals",
    "exclude": "--exclude",
}
"""Options that live controllers do not allow: they begin with the run and set its pace."""


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """The arguments of the command line, None where the user gave none."""

    run: Path
    rate: float = 1.0
    clock: str | None = None
    start_offset: str | None = None
    duration: str | None = None
    start_paused: bool = False
    loop: bool = False
    signals: str | None = None
    exclude: str | None = None
    wait: bool = False
    listen: str | None = None
    live: str | None = None
    plan: Path | None = None
    json: str | None = None


def check_request(request: ReplayRequest) -> None:
    """Refuse what is wrong whatever the recording is."""
    if not 0.0 <= request.rate <= _FASTEST_RATE:
        raise InputError(
            f"--rate: expected 0 (as fast as possible) to {_FASTEST_RATE:g}, got {request.rate:g}"
        )
    if request.clock not in (None, *CLOCKS):
        raise InputError(f"--clock: expected {' or '.join(CLOCKS)}, got {request.clock}")
    if request.listen is not None and not _ENDPOINT.fullmatch(request.listen):
        raise InputError(
            f"--listen: expected an address such as tcp/127.0.0.1:7447, got {request.listen}"
        )
    check_json_destination(request.json)
    if request.start_paused and not has_keyboard():
        raise InputError("--start-paused: expected a terminal, where space goes on")
    if request.live is None and request.plan is not None:
        raise InputError("--plan: expected --live with it: the live controllers run by this plan")
    for field in fields(request) if request.live is not None else ():
        option = _NOT_LIVE.get(field.name)
        if option is not None and getattr(request, field.name) != field.default:
            raise InputError(f"{option}: not possible with --live, which begins with the run")


def requested_span(request: ReplayRequest, reader: RunReader) -> Span:
    """Return the cycles to replay."""
    first = 0
    if request.start_offset is not None:
        try:
            first = reader.clock.cycle(request.start_offset)
        except InputError as error:
            raise InputError(f"--from {error}") from None
    return Span(first, cycle_after(request.duration, reader, first))


def cycle_after(duration: str | None, reader: RunReader, first: int) -> int | None:
    """Return the cycle after a duration, None if that is the end of the recording."""
    if duration is None:
        return None
    duration_ns = round(parse_duration_s(duration, "--duration") * 1e9)
    cycle = first + ceil(duration_ns / reader.plan.cycle_ns)
    return cycle if cycle <= reader.last_cycle else None
