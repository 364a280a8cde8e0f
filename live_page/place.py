"""Where a page is served: an address of this machine, a port, and a token where others reach it."""

from __future__ import annotations

import ipaddress
import secrets
import socket
from dataclasses import dataclass

from bus_schemas.errors import InputError


@dataclass(frozen=True)
class Place:
    """Where the page is served.

    The socket listens already, so that a browser may come before the server is up. A browser must
    know the token, which is empty on the loopback address: nobody else can reach that.
    """

    socket: socket.socket
    token: str

    def address(self, path: str = "") -> str:
        host, port = self.socket.getsockname()[:2]
        if ipaddress.ip_address(host).is_unspecified:
            host = socket.gethostname()
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{port}/{path}" + (f"?token={self.token}" if self.token else "")


def open_place(address: str | None, port: int | None) -> Place:
    """Take an address and a port for a page: by default the loopback address, and any free port."""
    try:
        ip = ipaddress.ip_address("127.0.0.1" if address in {None, "localhost"} else address)
    except ValueError:
        raise InputError(
            f"--page-address: expected an IP address such as 127.0.0.1 or 0.0.0.0, got {address}"
        ) from None
    family = socket.AF_INET6 if ip.version == 6 else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((str(ip), port or 0))
        listener.listen(100)
    except OSError as error:
        listener.close()
        raise InputError(
            f"--page-address, --page-port: expected a free port of this machine, got {ip} port "
            f"{port or 'any'}: {error.strerror}"
        ) from None
    return Place(listener, "" if ip.is_loopback else secrets.token_urlsafe(16))
