"""What the user wants of a replay, and what of it is refused."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from math import ceil
from pathlib import Path
from typing import Final

from bus_schemas.errors import InputError
from bus_schemas.times import parse_duration_s
from recordings.replay.keyboard import has_keyboard
from recordings.replay.player import Span
from recordings.replay.recorded_run import RecordedRun
from studies.report.run_report import check_destination

_FASTEST_RATE: Final = 1000.0
_ENDPOINT: Final = re.compile(r"tcp/[^/\s#?]+:\d{1,5}")

_NOT_LIVE: Final = {
    "rate": "--rate",
    "clock": "--clock",
    "start_offset": "--start-offset",
    "start_paused": "--start-paused",
    "loop": "--loop",
    "signals": "--signals",
    "exclude": "--exclude",
}
"""Options that make no sense with live agents: those begin with the run, and set its pace."""


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """The words of the command line, None where the user said nothing."""

    run: Path
    rate: float = 1.0
    clock: str = "wall"
    start_offset: str | None = None
    duration: str | None = None
    start_paused: bool = False
    loop: bool = False
    signals: str | None = None
    exclude: str | None = None
    wait: bool = False
    listen: str | None = None
    namespace: str | None = None
    live: str | None = None
    plan: Path | None = None
    json: str | None = None


def check_request(request: ReplayRequest) -> None:
    """Refuse what can be seen to be wrong before anything is read.

    Raises
    ------
    InputError
        A value that is not accepted, or options that do not go together.
    """
    if not 0.0 <= request.rate <= _FASTEST_RATE:
        raise InputError(
            f"--rate {request.rate:g}: accepted is a number from 0 (as fast as possible) to "
            f"{_FASTEST_RATE:g}"
        )
    if request.clock not in ("wall", "sim"):
        raise InputError(f"--clock {request.clock}: accepted are wall (as recorded) and sim")
    if request.listen is not None and not _ENDPOINT.fullmatch(request.listen):
        raise InputError(
            f"--listen {request.listen}: accepted is an address such as tcp/127.0.0.1:7447"
        )
    if request.json not in (None, "-"):
        check_destination(Path(request.json))
    _check_live(request)
    if request.start_paused and not has_keyboard():
        raise InputError("--start-paused: accepted in a terminal, where space goes on")


def _check_live(request: ReplayRequest) -> None:
    if request.live is None:
        if request.plan is not None:
            raise InputError("--plan: accepted with --live, whose controllers run by it")
        return
    for field in fields(request):
        option = _NOT_LIVE.get(field.name)
        if option is not None and getattr(request, field.name) != field.default:
            raise InputError(
                f"{option}: not accepted with --live, whose controllers begin with the run and "
                "set its pace"
            )


def requested_span(request: ReplayRequest, recorded: RecordedRun) -> Span:
    """Return the cycles to replay.

    Raises
    ------
    InputError
        The run does not have the first one, or the duration is none.
    """
    first = 0
    if request.start_offset is not None:
        try:
            first = recorded.clock.cycle(request.start_offset)
        except InputError as error:
            raise InputError(f"--start-offset {error}") from None
    return Span(first, before_cycle(request.duration, recorded, first))


def before_cycle(duration: str | None, recorded: RecordedRun, first: int) -> int | None:
    """Return the cycle before which the replay ends, None if that is the end of the recording."""
    if duration is None:
        return None
    duration_ns = round(parse_duration_s(duration, "--duration") * 1e9)
    before = first + ceil(duration_ns / recorded.plan.cycle_ns)
    return before if before < recorded.cycles else None
