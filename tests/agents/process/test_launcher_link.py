"""What a process tells its launcher arrives whole; a launcher that does not read delays no run."""

from __future__ import annotations

import socket
import threading

from agents.process.events import Event, Failed, Status
from agents.process.launcher_link import LauncherLink, decode_event

LONG = "x" * 1_000_000
STATUS = Status(1, 0, 0.0, 0.0, 0.0, ["y" * 10_000], 0)


def read(theirs: socket.socket) -> list[Event]:
    with theirs.makefile("rb") as lines:
        return [decode_event(line) for line in lines]


def test_a_long_event_comes_whole_and_each_event_in_its_order() -> None:
    ours, theirs = socket.socketpair()
    events = [STATUS, Failed(LONG), STATUS, Failed("short")]

    def tell() -> None:
        link = LauncherLink("recorder", ours)
        for event in events:
            link.tell(event)
        ours.close()

    telling = threading.Thread(target=tell)
    telling.start()
    assert [event for event in read(theirs) if isinstance(event, Failed)] == events[1::2]
    telling.join()


def test_a_launcher_that_does_not_read_lacks_whole_status_events_and_no_other() -> None:
    ours, theirs = socket.socketpair()
    link = LauncherLink("recorder", ours)
    for _ in range(1000):  # More than the socket takes; none of these calls waits.
        link.tell(STATUS)
    reading = threading.Thread(target=lambda: found.extend(read(theirs)))
    found: list[Event] = []
    reading.start()
    link.tell(Failed("at last"))
    ours.close()
    reading.join()
    assert 1 <= found.count(STATUS) < 1000
    assert found[-1] == Failed("at last")
    assert len(found) == found.count(STATUS) + 1
