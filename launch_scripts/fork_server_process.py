"""The launcher's end of the fork server, which starts all processes of a run."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

from agents.process.side_process import SideProcess

_HEAP: Final = {
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_THRESHOLD_": "32768",
    "MALLOC_TRIM_THRESHOLD_": "131072",
}
"""One heap of glibc in each process, and none of the buffers of Zenoh's links in it. Otherwise a
process grows with the links that end: see docs/decisions/0003-zenoh-tuning.md."""


class ForkServer(NamedTuple):
    """The fork server.

    control: Socket that keeps packets apart: requests go out; events come in, those of a start with
        the launcher's end of the link to the process.
    beats: Descriptor of the memory in which it and its processes beat.
    """

    side: SideProcess
    control: socket.socket
    beats: int

    @property
    def name(self) -> str:
        return f"fork server (process {self.side.process.pid})"

    def end(self) -> None:
        """Let it end what is left of its processes, and itself."""
        self.control.close()
        self.side.close()


@contextmanager
def fork_server() -> Iterator[ForkServer]:
    """Start the fork server; start it early, since it imports while others prepare."""
    control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    control.setblocking(False)
    beats = os.memfd_create("heliarch-beats")
    with theirs:
        side = SideProcess(
            "launch_scripts.fork_server",
            *(str(theirs.fileno()), str(beats)),
            env={
                **_HEAP,
                **os.environ,
                "PYTHONUNBUFFERED": "1",
                # An import must start no thread: this library would.
                "OPENBLAS_NUM_THREADS": "1",
            },
            pass_fds=(theirs.fileno(), beats),
        )
    try:
        yield ForkServer(side, control, beats)
    finally:  # `Processes` has ended it if it was asked for anything.
        side.process.kill()
        side.close()
        control.close()
        os.close(beats)
