"""Free TCP ports on the loopback address, kept free for the run that asked for them."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager


@contextmanager
def reserved_ports(agents: Sequence[str]) -> Iterator[dict[str, int]]:
    """Reserve a port for each agent, as long as the context lasts.

    The launcher keeps a socket bound to each port without listening on it. So no other launcher
    gets the same port from the kernel, while Zenoh, which sets SO_REUSEADDR as this does, can
    listen on it.
    """
    with ExitStack() as sockets:
        ports: dict[str, int] = {}
        for agent in agents:
            holder = sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
            holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            holder.bind(("127.0.0.1", 0))
            ports[agent] = holder.getsockname()[1]
        yield ports
