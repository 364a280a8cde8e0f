"""The link between a process of a run and the launcher."""

from __future__ import annotations

import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import reduce
from operator import or_
from typing import Final

import msgspec

from agents.process.beats import BeatTable
from agents.process.events import Event, Status

_PART: Final = 60_000
"""Bytes of an event in one packet: a socket takes packets of some 200 kB at most."""

_decoder: msgspec.json.Decoder[Event] = msgspec.json.Decoder(reduce(or_, Event.__subclasses__()))
"""Decodes any event, by its tag."""


class LauncherLink:
    """A process's end of the link. One that was started by hand prints its events.

    events: Socket that keeps packets apart, shared with the other processes of the run.
    table: Where the process beats.
    starts: How many processes the agent had before this one.

    dismissed: Whether the launcher wants the agent to end.
    """

    def __init__(
        self,
        name: str,
        events: socket.socket | None = None,
        table: BeatTable | None = None,
        starts: int = 0,
    ) -> None:
        self.dismissed = False
        self.starts = starts
        self.table = table
        self._name = name
        self._events = events

    @property
    def by_hand(self) -> bool:
        """Whether no launcher ends the process."""
        return self._events is None

    def end_on(self, *numbers: signal.Signals) -> None:
        """Treat signals as the launcher's request to end in order."""
        for number in numbers:
            signal.signal(number, self._dismiss)

    def _dismiss(self, *_: object) -> None:
        self.dismissed = True

    def beat(self, cycle: int) -> None:
        """Show that the loop that does the work is at work, or waits in this cycle."""
        if self.table is not None:
            self.table.beat(self._name, cycle)

    def expected_messages(self) -> int | None:
        """Return how many messages of the run were published in all; None: not known yet."""
        return self.table.expected() if self.table is not None else None

    def tell(self, event: Event) -> None:
        data = msgspec.json.encode(event)
        if self._events is None:
            sys.stdout.buffer.write(data + b"\n")
            sys.stdout.buffer.flush()
            return
        # A launcher that stands still must not delay the run.
        flags = socket.MSG_DONTWAIT if isinstance(event, Status) else 0
        # The launcher may be gone; the recorder still closes its file.
        with suppress(BrokenPipeError, ConnectionResetError, BlockingIOError):
            for packet in packets(self._name, data):
                self._events.send(packet, flags)


def packets(name: str, data: bytes) -> Iterator[bytes]:
    """Cut a text into packets: whether it is the first and the last, who says it, and a part."""
    for start in range(0, len(data) or 1, _PART):
        marks = ("^" if start == 0 else "-") + ("$" if start + _PART >= len(data) else "-")
        yield f"{marks}{name}\n".encode() + data[start : start + _PART]


class Packets:
    """Puts together again what was cut into packets."""

    def __init__(self) -> None:
        self._begun: dict[str, bytes] = {}

    def feed(self, packet: bytes) -> tuple[str, bytes] | None:
        """Take in a packet; return who said it and the text once it is whole.

        Who found no room for the rest of a text, or died, begins with another one.
        """
        head, _, part = packet.partition(b"\n")
        name = head[2:].decode()
        begun = b"" if head[:1] == b"^" else self._begun.pop(name, None)
        if begun is None:
            return None
        if head[1:2] == b"$":
            self._begun.pop(name, None)
            return name, begun + part
        self._begun[name] = begun + part
        return None


def decode_event(data: bytes) -> Event:
    return _decoder.decode(data)
