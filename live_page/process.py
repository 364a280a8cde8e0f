"""The page as a process of its own beside a run: where it is served, the launcher's hold on it.

The launcher writes the settings to the process's standard input, and `over` when the run is. The
process then ends as soon as no page is open; when the launcher is gone, at once.
"""

from __future__ import annotations

import ipaddress
import os
import secrets
import socket
import subprocess
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from agents.process.side_process import SideProcess
from bus_schemas.errors import InputError

_CLOSING_S: Final = 3.0
_NICE: Final = 10


@dataclass(frozen=True)
class PageAddress:
    """Where the page is served.

    The socket listens already, so that a browser may come before the server is up. A browser must
    know the token, which is empty on the loopback address: only this machine can reach that.
    """

    socket: socket.socket
    token: str

    def url(self) -> str:
        host, port = self.socket.getsockname()[:2]
        if ipaddress.ip_address(host).is_unspecified:
            host = socket.gethostname()
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{port}/" + (f"?token={self.token}" if self.token else "")

    def text(self) -> str:
        is_local = ipaddress.ip_address(self.socket.getsockname()[0]).is_loopback
        return self.url() + ("" if is_local else "   (not encrypted)")


def open_address(
    address: str | None, port: int | None, *, needs_token: bool = False
) -> PageAddress:
    """Take an address and a port for a page: by default the loopback address, and any free port.

    `needs_token`: Also on the loopback address, which every user of this machine reaches.
    """
    try:
        ip = ipaddress.ip_address("127.0.0.1" if address in {None, "localhost"} else address)
    except ValueError:
        raise InputError.of(
            "--page-address", f"expected an IP address such as 127.0.0.1 or 0.0.0.0, got {address}"
        ) from None
    family = socket.AF_INET6 if ip.version == 6 else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((str(ip), port or 0))
        listener.listen(100)
    except OSError as error:
        listener.close()
        raise InputError.of(
            "--page-address, --page-port",
            f"expected a free port of this machine, got {ip} port "
            f"{port or 'any'}: {error.strerror}",
        ) from None
    return PageAddress(
        listener, "" if ip.is_loopback and not needs_token else secrets.token_urlsafe(16)
    )


class PageSettings(msgspec.Struct):
    """What the process serves."""

    path: str
    several: bool
    socket: int
    token: str
    orders: bool = False


class PageProcess(SideProcess):
    """The page's process, as its launcher sees it. It ends with the context."""

    def __init__(self, address: str | None, port: int | None, *, orders: bool = False) -> None:
        self._address = open_address(address, port, needs_token=orders)
        self._orders = orders
        super().__init__(
            "live_page",
            stdout=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            pass_fds=(self._address.socket.fileno(),),
        )

    def __exit__(self, *error: object) -> None:
        self._address.socket.close()
        super().__exit__()

    def show(self, path: Path, *, several: bool = False) -> str:
        """Serve the run in a folder, or the `several` runs there; return the address to open.

        The folder may be made later.
        """
        number, token = self._address.socket.fileno(), self._address.token
        settings = PageSettings(str(path.absolute()), several, number, token, self._orders)
        self.tell(msgspec.json.encode(settings))
        return self._address.text()

    def let_end(self, say: Callable[[str], None]) -> None:
        """Wait until the page is no longer open anywhere, or until Ctrl-C."""
        self.tell(b"over")
        with suppress(KeyboardInterrupt):
            try:
                self.process.wait(_CLOSING_S)
            except subprocess.TimeoutExpired:
                say("page: still open in a browser; close it there or press Ctrl-C to end")
                self.process.wait()


def get_behind_others() -> None:
    """Let this process run when no other wants the core.

    In lockstep the processes of a run do not interrupt one of the normal policies when they wake.
    """
    os.nice(_NICE)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
