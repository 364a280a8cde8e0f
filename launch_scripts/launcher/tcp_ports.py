"""TCP ports on the loopback address, kept free for the run that asked for them."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

from bus_schemas.errors import InputError


@contextmanager
def reserved_ports(agents: Sequence[str], base_port: int | None = None) -> Iterator[dict[str, int]]:
    """Reserve a port for each agent, as long as the context lasts.

    The launcher keeps a socket bound to each port without listening on it. So no other launcher
    gets the same port from the kernel, while Zenoh, which sets SO_REUSEADDR as this does, can
    listen on it. Another launcher that asks for the very same port could bind it as well: a claim
    beside each port, which only one can have, keeps it off.

    Parameters
    ----------
    agents
        Who needs one.
    base_port
        Port of the first agent; the others get the next ones. None: whatever is free.

    Raises
    ------
    InputError
        One of the ports that were asked for is taken.
    """
    with ExitStack() as sockets:
        ports: dict[str, int] = {}
        for place, agent in enumerate(agents):
            wanted = 0 if base_port is None else base_port + place
            holder = sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
            holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                holder.bind(("127.0.0.1", wanted))
            except OSError as error:
                raise InputError(
                    f"--base-port {base_port}: port {wanted} of {agent} cannot be had: "
                    f"{error.strerror}"
                ) from None
            ports[agent] = holder.getsockname()[1]
            if not _claimed(ports[agent], sockets) and base_port is not None:
                raise InputError(
                    f"--base-port {base_port}: port {ports[agent]} of {agent} is that of another "
                    "run, accepted are ports that no run uses"
                )
        yield ports


def _claimed(port: int, sockets: ExitStack) -> bool:
    """Claim a port against other launchers of this host; it ends with the launcher, however.

    The claim is an abstract name, which only Linux has, and which leaves no file behind.
    """
    if sys.platform != "linux":
        return True
    claim = sockets.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
    try:
        claim.bind(f"\0heliarch-port-{port}")
    except OSError:
        return False
    return True
