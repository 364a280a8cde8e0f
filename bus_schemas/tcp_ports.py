"""TCP ports of this host, kept free for the run that asked for them."""

from __future__ import annotations

import socket
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager

from bus_schemas.errors import InputError


@contextmanager
def reserved_ports(
    agents: Sequence[str],
    base_port: int | None = None,
    address: str = "127.0.0.1",
    devices: Collection[str] = (),
) -> Iterator[dict[str, int]]:
    """Reserve a port of this host for each agent, until the context is left.

    A socket stays bound to each port without listening on it: the kernel gives it to no other
    program, but Zenoh, which sets SO_REUSEADDR as well, can listen on it. The agents get
    `base_port` and the next ones; None: any. A device may listen on its port already.
    """
    with ExitStack() as sockets:
        ports: dict[str, int] = {}
        for number, agent in enumerate(agents):
            wanted = 0 if base_port is None else base_port + number
            if wanted and agent in devices:
                ports[agent] = wanted
                continue
            family = socket.AF_INET6 if ":" in address else socket.AF_INET
            holder = sockets.enter_context(socket.socket(family, socket.SOCK_STREAM))
            holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                holder.bind((address, wanted))
            except OSError as error:
                where = f"--base-port: expected free ports, got port {wanted} of {agent}"
                if base_port is None:
                    where = f"--address: expected an address of this host, got {address}"
                raise InputError.of(where, str(error.strerror)) from None
            ports[agent] = holder.getsockname()[1]
        yield ports
