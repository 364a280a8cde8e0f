"""`heliarch replay`: a recording back on the bus, with or without live controllers."""

# What does the work is imported when it runs: `--help` does not wait for it.
# ruff: noqa: PLC0415

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, TextIO

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.boundary import INTERRUPTED, OK
from launch_scripts.commands.options import (
    FirstOption,
    JsonOption,
    LastOption,
    RunArgument,
    SignalsOption,
)
from launch_scripts.commands.output import write_json

if TYPE_CHECKING:
    from recordings.replay.keyboard import Keyboard

EXAMPLE: Final = "heliarch replay runs/oahu-4711 --from 13:49:00 --pace 0.5"

_ENDPOINT: Final = re.compile(r"tcp/[^/\s#?]+:\d{1,5}")


def replay(
    run: RunArgument,
    start: FirstOption = None,
    end: LastOption = None,
    pace: Annotated[
        str, typer.Option(help="Recorded seconds per second, or max.", metavar="PACE")
    ] = "1",
    clock: Annotated[
        Literal["sim", "wall"],
        typer.Option(
            help="What spaces messages: sim (cycles as the plant lives them) or wall (as they were "
            "published)."
        ),
    ] = "sim",
    start_paused: Annotated[
        bool, typer.Option("--start-paused", help="Wait for the space bar.")
    ] = False,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    signals: SignalsOption = None,
    exclude: Annotated[
        str | None, typer.Option(help="All but these; clock too may be one.", metavar="NAMES")
    ] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Begin when a subscriber is there.")] = False,
    listen: Annotated[
        str | None,
        typer.Option(
            help="Where subscribers connect: tcp/127.0.0.1:7447; default a free port.",
            metavar="ENDPOINT",
        ),
    ] = None,
    live: Annotated[
        str | None,
        typer.Option(
            help="Controllers that run live, and are compared: c1/inv01,c2.", metavar="NODES"
        ),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(help="Plan of the live controllers; default the run's.", metavar="FILE"),
    ] = None,
    json: JsonOption = None,
) -> int:
    """Put a recording back onto the bus, or let some agents of it run live.

    In a terminal: space pauses and goes on, s steps one cycle, + and - change
    the pace, arrows seek (left and right 10 s, up and down 1 min of simulated
    time), q ends.
    """
    from launch_scripts.launcher.interruption import interruptible
    from launch_scripts.launcher.request import parse_pace
    from recordings.replay.clock import PlaybackClock, RecordedSpacing, SimulatedSpacing
    from recordings.replay.figures import ReplayFigures, print_replay
    from recordings.replay.keyboard import has_keyboard
    from recordings.replay.player import Player, Span
    from recordings.replay.progress import ProgressLine
    from recordings.replay.recorded_run import RecordedRun
    from recordings.replay.selection import select
    from recordings.replay.session import await_subscriber, introduce, replay_session

    out = sys.stderr if json == "-" else sys.stdout
    if listen is not None and not _ENDPOINT.fullmatch(listen):
        raise InputError(f"--listen: expected an address such as tcp/127.0.0.1:7447, got {listen}")
    if live is not None:
        from launch_scripts.commands.replay_live import LiveRequest, replay_live

        refused = {
            "--from": start, "--start-paused": start_paused, "--loop": loop, "--signals": signals,
            "--exclude": exclude, "--pace": pace != "1", "--clock": clock != "sim",
        }  # fmt: skip
        _check_live(refused)
        return replay_live(LiveRequest(run, end, wait, listen, live, plan, json), out)
    if plan is not None:
        raise InputError("--plan: expected --live with it, whose controllers run by it")
    if start_paused and not has_keyboard():
        raise InputError("--start-paused: expected a terminal, where the space bar goes on")
    parsed = parse_pace(pace)
    rate = parsed if isinstance(parsed, float) else 0.0
    with RecordedRun(run) as recorded:
        selection = select(recorded.plan, signals, exclude)
        span = recorded.clock.span(start, end)
        introduce(recorded, out)
        progress = ProgressLine(out, recorded.plan)
        with (
            interruptible() as interruption,
            replay_session(recorded, selection, None, listen, out) as session,
            _announced_keyboard(out) as keys,
        ):
            player = Player(
                recorded,
                Span(span.start, None if end is None else span.stop),
                selection,
                session,
                PlaybackClock(rate, paused=start_paused),
                lambda: RecordedSpacing() if clock == "wall" else SimulatedSpacing(recorded.plan),
                keys,
                interruption,
                progress,
            )
            if wait:
                await_subscriber(session, interruption, out)
            began_at = time.monotonic()
            player.play(loop=loop)
            wall_s = time.monotonic() - began_at
            progress.close()
    played, was_interrupted = player.played, bool(interruption)
    figures = ReplayFigures(
        recorded.plan.run_id,
        str(recorded.path),
        played.messages,
        played.cycles,
        wall_s,
        rate,
        clock,
        played.timing.figures(),
        was_interrupted,
    )
    print_replay(figures, out)
    write_json(figures, json)
    return INTERRUPTED if was_interrupted else OK


def _check_live(options: Mapping[str, object]) -> None:
    for option, given in options.items():
        if given:
            raise InputError(
                f"{option}: expected none with --live, whose controllers begin with the run and "
                "set its pace"
            )


@contextmanager
def _announced_keyboard(out: TextIO) -> Iterator[Keyboard]:
    from recordings.replay.keyboard import KEYS_IN_WORDS, has_keyboard, keyboard

    with keyboard() as keys:
        if has_keyboard():
            out.write(f"{KEYS_IN_WORDS}\n")
            out.flush()
        yield keys
