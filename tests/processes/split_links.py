"""TCP proxies that hand on Zenoh's batches with each length field in two parts, and count them."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_PAUSE_S = 0.002


class SplitLink:
    """Listens on a port of its own and forwards to a target, for as long as the test goes on."""

    def __init__(self, target: int) -> None:
        self.received = 0
        self._target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                near.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                try:
                    far = socket.create_connection(("127.0.0.1", self._target))
                except OSError:  # It does not listen yet.
                    near.close()
                    continue
                for run, one, other in ((self._up, near, far), (self._down, far, near)):
                    threading.Thread(target=run, args=(one, other), daemon=True).start()

    def _up(self, near: socket.socket, far: socket.socket) -> None:
        with suppress(OSError), far:
            while data := near.recv(65_536):
                far.sendall(data)

    def _down(self, far: socket.socket, near: socket.socket) -> None:
        with suppress(OSError, EOFError), near:
            while True:
                length = _exactly(far, 2)
                batch = _exactly(far, length[0] | length[1] << 8)
                self.received += len(batch)
                near.sendall(length[:1])
                time.sleep(_PAUSE_S)
                near.sendall(length[1:] + batch)


def _exactly(source: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        if not (more := source.recv(size - len(data))):
            raise EOFError
        data += more
    return data


@contextmanager
def split_links(*targets: int) -> Iterator[list[SplitLink]]:
    """Open a proxy to each of some ports."""
    links = [SplitLink(target) for target in targets]
    try:
        yield links
    finally:
        for link in links:
            link.close()


def free_ports(count: int) -> int:
    """Return the first of some ports in a row that nobody uses now."""
    for first in range(21_000, 32_000, count):
        with suppress(OSError):
            for port in range(first, first + count):
                socket.create_server(("127.0.0.1", port)).close()
            return first
    raise AssertionError("no free ports")
