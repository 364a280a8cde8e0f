"""The launcher's handle of the fork server, which starts all processes of a run."""

from __future__ import annotations

import os
import socket
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import Final

import msgspec

from agents.process.events import Request
from agents.process.side_process import SideProcess

_LARGEST_PACKET: Final = 1 << 16
_MOST_PACKETS: Final = 500

_HEAP: Final = {
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_THRESHOLD_": "32768",
    "MALLOC_TRIM_THRESHOLD_": "131072",
}
"""One heap of glibc in each process, and none of the buffers of Zenoh's links in it. Otherwise a
process grows with the links that end: see docs/decisions/0003-zenoh-tuning.md."""


class ForkServerProcess(SideProcess):
    """The fork server. Start it early: it imports while others prepare.

    control: Socket that keeps packets apart: requests go out, events of the server come in.
    beats: Descriptor of the memory in which it and its processes beat.
    failure: Why it has failed, if it has said so.
    """

    def __init__(self) -> None:
        self.control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.control.setblocking(False)
        self.beats = os.memfd_create("heliarch-beats")
        self.failure = ""
        self._was_asked = False
        self._unsent: deque[tuple[bytes, socket.socket | None]] = deque()
        with theirs:
            super().__init__(
                "launch_scripts.fork_server",
                *(str(theirs.fileno()), str(self.beats)),
                env={
                    **_HEAP,
                    **os.environ,
                    "PYTHONUNBUFFERED": "1",
                    # An import must start no thread: this library would.
                    "OPENBLAS_NUM_THREADS": "1",
                },
                pass_fds=(theirs.fileno(), self.beats),
            )

    def ask(self, request: Request, link: socket.socket | None = None) -> None:
        """Send a request, and with it the end of a process's link."""
        self._was_asked = True
        self._unsent.append((msgspec.json.encode(request), link))
        self.send_requests()

    def send_requests(self) -> None:
        """Send requests while there is room, without blocking: the server may not read now.

        To be called again and again: a server that forks hundreds waits until its events are read.
        """
        with suppress(BrokenPipeError, ConnectionResetError, BlockingIOError):
            while self._unsent:
                packet, link = self._unsent[0]
                socket.send_fds(self.control, [packet], [] if link is None else [link.fileno()])
                self._unsent.popleft()
                if link is not None:
                    link.close()

    def packets(self) -> Iterator[bytes]:
        """Yield what has come from the server; an empty packet if it is gone."""
        for _ in range(_MOST_PACKETS):
            try:
                packet = self.control.recv(_LARGEST_PACKET)
            except BlockingIOError:
                return
            except ConnectionResetError:
                packet = b""
            yield packet
            if not packet:
                return

    def hang_up(self) -> None:
        """Let it end what is left of its processes, and itself."""
        super().hang_up()
        self.control.close()
        while self._unsent:
            if (link := self._unsent.popleft()[1]) is not None:
                link.close()
        if self.beats >= 0:
            os.close(self.beats)
            self.beats = -1
        if not self._was_asked:  # It has no processes.
            self.process.kill()
