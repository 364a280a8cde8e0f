"""`heliarch replay`: from the command line's words to an exit status."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from bus_schemas.errors import InputError
from launch_scripts.commands.replay_live import replay_live
from launch_scripts.commands.replay_request import ReplayRequest, check_request, requested_span
from launch_scripts.exit_status import BAD_INPUT, FAILED, INTERRUPTED, OK, complain
from launch_scripts.launcher.interruption import interruptible
from launch_scripts.launcher.supervision import RunFailure
from recordings.replay.clock import PlaybackClock, RecordedSpacing, SimulatedSpacing, Spacing
from recordings.replay.figures import (
    ReplayFigures,
    print_replay,
    write_json,
)
from recordings.replay.keyboard import KEYS_IN_WORDS, Keyboard, has_keyboard, keyboard
from recordings.replay.player import Played, Player
from recordings.replay.progress import ProgressLine
from recordings.replay.recorded_run import RecordedRun
from recordings.replay.selection import select
from recordings.replay.session import await_subscriber, introduce, replay_session


def replay(request: ReplayRequest) -> int:
    """Replay what was asked for and say what it came to. Returns the exit status."""
    # With the JSON on standard output, nothing else may go there.
    out = sys.stderr if request.json == "-" else sys.stdout
    try:
        check_request(request)
        with RecordedRun(request.run) as recorded:
            if request.live is not None:
                return replay_live(request, recorded, out)
            return _replay(request, recorded, out)
    except InputError as error:
        return complain(error, BAD_INPUT)
    except RunFailure as error:
        return complain(error, FAILED)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)


def _replay(request: ReplayRequest, recorded: RecordedRun, out: TextIO) -> int:
    selection = select(recorded.plan, request.signals, request.exclude)
    span = requested_span(request, recorded)
    introduce(recorded, out)
    progress = ProgressLine(out, recorded.plan)
    with (
        interruptible() as interruption,
        replay_session(recorded, selection, request.namespace, request.listen, out) as session,
        _announced_keyboard(out) as keys,
    ):
        player = Player(
            recorded,
            span,
            selection,
            session,
            PlaybackClock(request.rate, paused=request.start_paused),
            lambda: _spacing(request, recorded),
            keys,
            interruption,
            progress,
        )
        if request.wait:
            await_subscriber(session, interruption, out)
        began_at = time.monotonic()
        player.play(loop=request.loop)
        wall_s = time.monotonic() - began_at
        progress.close()
    figures = _figures(request, recorded, player.played, wall_s, bool(interruption))
    print_replay(figures, out)
    write_json(figures, request.json)
    return INTERRUPTED if interruption else OK


@contextmanager
def _announced_keyboard(out: TextIO) -> Iterator[Keyboard]:
    with keyboard() as keys:
        if has_keyboard():
            out.write(f"{KEYS_IN_WORDS}\n")
            out.flush()
        yield keys


def _spacing(request: ReplayRequest, recorded: RecordedRun) -> Spacing:
    return RecordedSpacing() if request.clock == "wall" else SimulatedSpacing(recorded.plan)


def _figures(
    request: ReplayRequest, recorded: RecordedRun, played: Played, wall_s: float, interrupted: bool
) -> ReplayFigures:
    return ReplayFigures(
        recorded.plan.run_id,
        str(recorded.path),
        played.messages,
        played.cycles,
        wall_s,
        request.rate,
        request.clock,
        played.timing.figures(),
        interrupted,
    )
