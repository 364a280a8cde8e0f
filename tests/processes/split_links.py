"""TCP proxies that hand on Zenoh's batches with each length field in two parts, and count them."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from socketserver import BaseRequestHandler, ThreadingTCPServer

_PAUSE_S = 0.002


class SplitLink(ThreadingTCPServer):
    """Listens on a port of its own and forwards to a target, for as long as the test goes on."""

    daemon_threads = True

    def __init__(self, target: int) -> None:
        super().__init__(("127.0.0.1", 0), _Connection)
        self.target = target
        self.received = 0
        self.endpoint = f"tcp/127.0.0.1:{self.server_address[1]}"
        threading.Thread(target=self.serve_forever, daemon=True).start()


class _Connection(BaseRequestHandler):
    """One connection; it is closed where the target does not listen yet."""

    server: SplitLink

    def handle(self) -> None:
        near: socket.socket = self.request
        near.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with suppress(OSError), socket.create_connection(("127.0.0.1", self.server.target)) as far:
            threading.Thread(target=self._up, args=(near, far), daemon=True).start()
            batches = far.makefile("rb")
            while length := batches.read(2):
                batch = batches.read(int.from_bytes(length, "little"))
                self.server.received += len(batch)
                near.sendall(length[:1])
                time.sleep(_PAUSE_S)
                near.sendall(length[1:] + batch)

    def _up(self, near: socket.socket, far: socket.socket) -> None:
        with suppress(OSError):
            while data := near.recv(65_536):
                far.sendall(data)
            far.shutdown(socket.SHUT_RDWR)


@contextmanager
def split_links(*targets: int) -> Iterator[list[SplitLink]]:
    """Open a proxy to each of some ports."""
    with ExitStack() as stack:
        links = [stack.enter_context(SplitLink(target)) for target in targets]
        for link in links:
            stack.callback(link.shutdown)
        yield links
