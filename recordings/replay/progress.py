"""Where a replay stands, as one line: renewed in place in a terminal, now and then elsewhere."""

from __future__ import annotations

import time
from typing import Final, TextIO

from agents.plan import RunPlan
from launch_scripts.launcher.live_view import local_time
from recordings.replay.clock import PlaybackClock

_TERMINAL_S: Final = 0.1
_PLAIN_S: Final = 2.0


class ProgressLine:
    """The line.

    Parameters
    ----------
    stream
        Where it goes.
    plan
        Of the run.
    """

    def __init__(self, stream: TextIO, plan: RunPlan) -> None:
        self._stream = stream
        self._plan = plan
        self._in_place = stream.isatty()
        self._next_at = 0.0
        self._shown = False

    def show(self, cycle: int, clock: PlaybackClock | None = None, *, now: bool = False) -> None:
        """Show a cycle, if the last line is old enough or it must be now.

        Parameters
        ----------
        cycle
            The cycle under way; below 0 nothing is shown.
        clock
            Tells rate and pause.
        now
            Whether a terminal must show it at once.
        """
        moment = time.monotonic()
        if cycle < 0 or (moment < self._next_at and not (now and self._in_place)):
            return
        self._next_at = moment + (_TERMINAL_S if self._in_place else _PLAIN_S)
        text = self._text(cycle, clock)
        self._stream.write(f"\r\x1b[K{text}" if self._in_place else f"{text}\n")
        self._stream.flush()
        self._shown = True

    def close(self) -> None:
        """Leave the line."""
        if self._shown and self._in_place:
            self._stream.write("\n")
            self._stream.flush()

    def _text(self, cycle: int, clock: PlaybackClock | None) -> str:
        sim_time = local_time(self._plan.sim_time_ns(cycle), self._plan.timezone)
        where = f"{sim_time} cycle {cycle} of {self._plan.cycles}"
        if clock is None:
            return where
        rate = f"rate {clock.rate:g}" if clock.rate else "as fast as possible"
        return f"{where} {rate}{' paused' if clock.paused else ''}"
