"""The link between a process of a run and the launcher."""

from __future__ import annotations

import signal
import socket
from functools import reduce
from operator import or_

import msgspec

from agents.process.beats import BeatTable
from agents.process.events import Event, Status

_decoder: msgspec.json.Decoder[Event] = msgspec.json.Decoder(reduce(or_, Event.__subclasses__()))
"""Decodes any event, by its tag."""


class LauncherLink:
    """A process's end of the link. One that was started by hand has nobody to tell.

    events: Socket, to which it writes a line for each event.
    table: Where the process beats.
    starts: How many processes the agent had before this one.

    """

    def __init__(
        self,
        name: str,
        events: socket.socket | None = None,
        table: BeatTable | None = None,
        starts: int = 0,
    ) -> None:
        self.starts = starts
        self.table = table
        self._name = name
        self._events = events
        self._unsent = b""
        self._was_told_to_end = False

    @property
    def dismissed(self) -> bool:
        return self._was_told_to_end or (
            self.table is not None and self.table.is_dismissed(self._name)
        )

    def end_on(self, *numbers: signal.Signals) -> None:
        """Treat signals as the launcher's request to end in order."""
        for number in numbers:
            signal.signal(number, self._dismiss)

    def _dismiss(self, *_: object) -> None:
        self._was_told_to_end = True

    def beat(self, cycle: int) -> None:
        """Show that the loop that does the work is at work, or waits in this cycle."""
        if self.table is not None:
            self.table.beat(self._name, cycle)

    def expected_messages(self) -> int | None:
        """Return how many messages of the run were published in all; None: not known yet."""
        return self.table.expected() if self.table is not None else None

    def tell(self, event: Event) -> None:
        if self._events is None:
            return
        line = msgspec.json.encode(event) + b"\n"
        may_wait = not isinstance(event, Status)  # A launcher that stands still delays no run.
        if may_wait or self._sends_rest(may_wait=False):
            self._unsent += line
            self._sends_rest(may_wait=may_wait)

    def _sends_rest(self, *, may_wait: bool) -> bool:
        """Send what is left of earlier lines; return whether nothing is left."""
        assert self._events is not None
        try:
            while self._unsent:
                sent = self._events.send(self._unsent, 0 if may_wait else socket.MSG_DONTWAIT)
                self._unsent = self._unsent[sent:]
        except BlockingIOError:
            return False
        except (BrokenPipeError, ConnectionResetError):
            self._unsent = b""  # The launcher is gone; the recorder still closes its file.
        return True


def decode_event(line: bytes) -> Event:
    return _decoder.decode(line)
