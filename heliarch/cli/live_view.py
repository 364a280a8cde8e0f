"""The view of a run in progress: a line that is renewed in a terminal, lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import datetime
from sys import maxsize
from typing import IO, Final, Self
from zoneinfo import ZoneInfo

from rich.console import Console

from agents.plan import RunPlan
from agents.process.events import Status
from bus_schemas.errors import listed, printable

_PLAIN_S: Final = 2.0
_IN_PLACE_S: Final = 0.1
_NAMED: Final = 6


class StatusLine:
    """Where a run or a replay stands, as one line: renewed in place, or printed every 2 s."""

    def __init__(self, stream: IO[str], *, in_place: bool) -> None:
        self._stream = stream
        self._in_place = in_place
        self._next_at = 0.0
        self._shown = ""

    def is_due(self) -> bool:
        return time.monotonic() >= self._next_at

    def show(self, text: str) -> None:
        self._next_at = time.monotonic() + (_IN_PLACE_S if self._in_place else _PLAIN_S)
        if text != self._shown:
            self._write(f"\r\x1b[K{text}" if self._in_place else f"{text}\n")
            self._shown = text

    def end(self) -> None:
        """Leave the line as it is, and go on below it."""
        if self._shown and self._in_place:
            self._write("\n")
            self._shown = ""

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


class PlainView:
    """Shows a run as a status line, and lines that stay."""

    def __init__(self, console: Console, plan: RunPlan) -> None:
        self._console = console
        self._cycles = plan.timing.cycles
        self._zone = ZoneInfo(plan.timing.timezone)
        self._line = StatusLine(console.file, in_place=console.is_terminal)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._line.end()

    def say(self, text: str) -> None:
        self._line.end()
        self._console.print(printable(text), highlight=False, soft_wrap=True, markup=False)

    def show(self, status: Status) -> None:
        """Show where the run stands, if the last line about it is old enough."""
        if status.cycle < 0 or not self._line.is_due():
            return
        local = datetime.fromtimestamp(status.sim_time_ns / 1e9, self._zone)
        # A line that wraps cannot be renewed.
        room = self._console.width - 1 if self._console.is_terminal else maxsize
        text = f"{local:%H:%M:%S} {status.cycle + 1} of {self._cycles} cycles"
        powers_kw = status.dispatch_kw, status.delivered_kw, status.available_kw
        for name, kw in zip(("dispatch", "delivered", "available"), powers_kw, strict=True):
            part = f", {name} {kw:.0f} kW"
            text += part if len(text + part) <= room else ""
        help_text = f"; help: {_needy(status.needy, room - len(text + '; help: '))}"
        self._line.show(text + help_text if len(text + help_text) <= room else text)


def _needy(nodes: Sequence[str], room: int) -> str:
    """Name nodes that lack power, as many as there is room for.

    A cluster that lacks power contains inverters that do: the clusters come first.
    """
    ordered = sorted(nodes, key=lambda node: (node.count("/"), node))
    names = [node or "the whole plant" for node in ordered]
    texts = [listed(names, most) for most in range(min(len(names), _NAMED), 0, -1)]
    fitting = (text for text in texts if len(text) <= room)
    return next(fitting, f"{len(names)} nodes" if names else "none")
