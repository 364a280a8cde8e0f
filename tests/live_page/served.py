"""The page's server in a thread of the test, and what it answers."""

from __future__ import annotations

import asyncio
import json
import os
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.client import HTTPResponse
from pathlib import Path
from typing import Any

import psutil
from recordings_by_hand import PLAN, SCENARIO, cycle_of_the_plant
from running import Heliarch

from bus_schemas.bus import Outbox
from bus_schemas.codec import encode
from live_page.process import PageAddress, open_address
from live_page.server import PageServer
from recordings.record.writer import RunWriter


class Served:
    """A server, and where it is."""

    def __init__(self, server: PageServer, address: PageAddress) -> None:
        self.server = server
        self.address, self.printed = address.url(), address.text()
        self.root = address.url().partition("?")[0]

    def get(self, path: str) -> Any:  # noqa: ANN401 - JSON
        """Return the document at a path."""
        with urllib.request.urlopen(self.root + path, timeout=30) as answer:
            return json.load(answer)

    def status(self, path: str, method: str = "GET", **headers: str) -> int:
        """Return the status of the answer to a request."""
        request = urllib.request.Request(self.root + path, method=method, headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=30) as answer:
                return int(answer.status)
        except urllib.error.HTTPError as error:
            return error.code

    def order(self, body: bytes, method: str = "POST", **headers: str) -> tuple[int, str]:
        """Send an order as a browser does; return the status and the text of the answer."""
        try:
            with self.opened_order(body, method, **headers) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()

    def opened_order(self, body: bytes, method: str = "POST", **headers: str) -> HTTPResponse:
        """Send an order; return the answer while it comes."""
        origin = self.root.removesuffix("/")
        port, token = self.root.rstrip("/").rpartition(":")[2], self.address.partition("token=")[2]
        cookie = f"heliarch-page-{port}={token}"
        own = {"Origin": origin, "Content-Type": "application/json", "Cookie": cookie} | headers
        own = {name: value for name, value in own.items() if value}
        request = urllib.request.Request(self.root + "order", body, own, method=method)
        answer: HTTPResponse = urllib.request.urlopen(request, timeout=30)
        return answer

    def updates(self, path: str = "stream") -> Iterator[dict[str, Any]]:
        """Yield what a browser is sent."""
        with urllib.request.urlopen(self.root + path, timeout=30) as answer:
            for line in answer:
                if line.startswith(b"data: "):
                    yield json.loads(line[6:])


@contextmanager
def served(
    path: Path,
    *,
    several: bool = False,
    address: str = "127.0.0.1",
    port: int = 0,
    orders: bool = False,
) -> Iterator[Served]:
    """Serve a run, or several."""
    where = open_address(address, port, needs_token=orders)
    server = PageServer(path, where, several=several, orders=orders)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve()))
    thread.start()
    try:
        yield Served(server, where)
    finally:
        server.end()
        thread.join(20)
        assert not thread.is_alive()


@contextmanager
def growing_run(path: Path) -> Iterator[Callable[[int], None]]:
    """Write a recording by hand; give a function that adds a cycle to it."""
    outbox, writer = Outbox(), RunWriter(path, PLAN, SCENARIO, driver="simulate")

    def add(cycle: int) -> None:
        for port, message in cycle_of_the_plant(cycle):
            outbox.stamp(port, message, time.monotonic_ns())
            writer.add(port, message, encode(message), time.monotonic_ns())
        writer.flush()

    yield add
    writer.close()


def page_of(run: Heliarch) -> str:
    """Return the address of the page beside a run.

    The page stands back for whatever else wants the machine: here it does not, so that it comes in
    time on a machine that is busy.
    """
    address = run.until_said("page: ")
    (page,) = [
        child
        for child in psutil.Process(run.process.pid).children()
        if child.cmdline()[-1] == "live_page"
    ]
    if sys.platform == "linux":
        run.until(lambda: os.sched_getscheduler(page.pid) == os.SCHED_IDLE, "its page")
        for thread in page.threads():
            os.sched_setscheduler(thread.id, os.SCHED_OTHER, os.sched_param(0))
    return address
