"""Where a replay stands, as one line: renewed in place in a terminal, every 2 s elsewhere."""

from __future__ import annotations

import time
from typing import Final, TextIO

from recordings.read.moments import RunClock

_TERMINAL_S: Final = 0.1
_PLAIN_S: Final = 2.0


class ProgressLine:
    """The line, for a recording with this clock and last cycle."""

    def __init__(self, stream: TextIO, clock: RunClock, last_cycle: int) -> None:
        self._stream = stream
        self._clock = clock
        self._last_cycle = last_cycle
        self._in_place = stream.isatty()
        self._next_at = 0.0
        self._shown = ""

    def show(self, cycle: int, state: str = "", *, now: bool = False) -> None:
        """Show a cycle, if the last line is old enough or a terminal must show it now."""
        moment = time.monotonic()
        if cycle >= 0 and (moment >= self._next_at or (now and self._in_place)):
            self._next_at = moment + (_TERMINAL_S if self._in_place else _PLAIN_S)
            self._write(cycle, state)

    def end(self, cycle: int, state: str = "") -> None:
        """Show the cycle where the replay ended."""
        if cycle >= 0:
            self._write(cycle, state)
        if self._shown and self._in_place:
            self._stream.write("\n")
            self._stream.flush()

    def _write(self, cycle: int, state: str) -> None:
        cycle = min(cycle, self._last_cycle)
        text = f"{self._clock.text(cycle)} cycle {cycle} of 0 to {self._last_cycle}{state}"
        if text != self._shown:
            self._stream.write(f"\r\x1b[K{text}" if self._in_place else f"{text}\n")
            self._stream.flush()
            self._shown = text
