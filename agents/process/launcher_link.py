"""The link between a process of a run and the launcher."""

from __future__ import annotations

import os
import signal
import socket
import sys
from contextlib import suppress
from functools import reduce
from operator import or_
from typing import Final

import msgspec

from agents.process.events import Alive, Event, Status

_PART: Final = 60_000
"""Bytes of an event in one packet: a socket takes packets of some 200 kB at most."""

_decoder: msgspec.json.Decoder[Event] = msgspec.json.Decoder(reduce(or_, Event.__subclasses__()))
"""Decodes any event, by its tag."""


class LauncherLink:
    """A process's end of the link. One that was started by hand prints its events.

    events: Socket that keeps packets apart, shared with the other processes of the run.
    expected: Pipe on which the launcher tells the recorder how many messages to expect.

    starts: How many processes the agent had before this one.

    dismissed: Whether the launcher wants the agent to end.
    unheard: Whether the launcher has found since this was last set to False that nobody hears the
        agent, whose sessions are then to be opened anew.
    """

    def __init__(
        self,
        agent: str,
        events: socket.socket | None = None,
        expected: int | None = None,
        starts: int = 0,
    ) -> None:
        self.dismissed = False
        self.unheard = False
        self.starts = starts
        self._agent = agent
        self._events = events
        self._expected = expected

    @property
    def by_hand(self) -> bool:
        """Whether no launcher ends the process."""
        return self._events is None

    def end_on(self, *numbers: signal.Signals) -> None:
        """Treat signals as the launcher's request to end in order."""
        for number in numbers:
            signal.signal(number, self._dismiss)

    def reopen_on(self, number: signal.Signals) -> None:
        """Treat a signal as the launcher's word that nobody hears the agent."""
        signal.signal(number, self._note_unheard)

    def _dismiss(self, *_: object) -> None:
        self.dismissed = True

    def _note_unheard(self, *_: object) -> None:
        self.unheard = True

    def tell(self, event: Event) -> None:
        data = msgspec.json.encode(event)
        if self._events is None:
            sys.stdout.buffer.write(data + b"\n")
            sys.stdout.buffer.flush()
            return
        # A launcher that stands still must not delay the run.
        flags = socket.MSG_DONTWAIT if isinstance(event, Status | Alive) else 0
        # The launcher may be gone; the recorder still closes its file.
        with suppress(BrokenPipeError, ConnectionResetError, BlockingIOError):
            for packet in packets(self._agent, data):
                self._events.send(packet, flags)

    def expected_messages(self) -> int | None:
        """Return how many messages of the run were published in all; None: not known yet."""
        if self._expected is None:
            return None
        with suppress(BlockingIOError, ValueError):  # Nothing yet, or the server is gone.
            return int(os.read(self._expected, 32))
        return None


def packets(agent: str, data: bytes) -> list[bytes]:
    """Cut an event into packets: a mark for the last one, the agent, a part of the event."""
    parts = [data[start : start + _PART] for start in range(0, len(data), _PART)]
    head = f"{agent}\n".encode()
    return [b"+" + head + part for part in parts[:-1]] + [b"." + head + parts[-1]]


def server_packet(agent: str, data: bytes) -> bytes:
    """Return a packet of the fork server about an agent, with a whole event."""
    return b"!" + f"{agent}\n".encode() + data


class EventReader:
    """The launcher's end: puts events together again."""

    def __init__(self) -> None:
        self._parts: dict[str, bytes] = {}

    def feed(self, packet: bytes) -> tuple[str, Event] | None:
        """Take in a packet; return agent and event once it is whole."""
        name, _, part = packet[1:].partition(b"\n")
        agent = name.decode()
        begun = self._parts.pop(agent, b"")
        if packet[:1] == b"+":
            self._parts[agent] = begun + part
            return None
        # An agent of which the server speaks does not complete the event that it has begun.
        return agent, _decoder.decode(part if packet[:1] == b"!" else begun + part)
