"""Two hosts with a slow network between them: namespaces, and a wire that keeps packets back.

Not every kernel has netem, so packets go through this process.
"""

from __future__ import annotations

import fcntl
import os
import select
import struct
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

HOP_MS: Final = 20.0
ADDRESSES: Final = ("10.217.0.1", "10.217.0.2")

_SET_INTERFACE: Final = 0x400454CA
_TUN_WITHOUT_HEADER: Final = 0x1001


@contextmanager
def slow_network(names: Sequence[str]) -> Iterator[None]:
    """Make two namespaces of the network with a wire between them."""
    ends: list[int] = []
    try:
        for name, (own, other) in zip(names, (ADDRESSES, ADDRESSES[::-1]), strict=True):
            device = f"wire{os.getpid()}-{len(ends)}"
            ends.append(os.open("/dev/net/tun", os.O_RDWR))
            request = struct.pack("16sH", device.encode(), _TUN_WITHOUT_HEADER)
            fcntl.ioctl(ends[-1], _SET_INTERFACE, request)
            _ip("netns", "add", name)
            _ip("link", "set", device, "netns", name)
            _ip("-n", name, "addr", "add", own, "peer", other, "dev", device)
            for link in ("lo", device):
                _ip("-n", name, "link", "set", link, "up")
        threading.Thread(target=_carry, args=ends, daemon=True).start()
        yield
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "delete", name], check=False, capture_output=True)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


def _carry(first: int, second: int) -> None:
    """Take each packet to the other end, some time later, until the namespaces are gone."""
    under_way: deque[tuple[float, int, bytes]] = deque()
    with suppress(OSError):
        while True:
            wait_s = max(under_way[0][0] - time.monotonic(), 0.0) if under_way else None
            for end in select.select([first, second], [], [], wait_s)[0]:
                other = second if end == first else first
                under_way.append((time.monotonic() + HOP_MS / 1e3, other, os.read(end, 65_536)))
            while under_way and under_way[0][0] <= time.monotonic():
                _, end, packet = under_way.popleft()
                os.write(end, packet)
