"""The queue between the bus's thread and an agent's: wakes it when there is enough to do."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any, cast

import zenoh

from bus_schemas.inbox import Inbox
from bus_schemas.messages import Message
from bus_schemas.signals import IMPP, RUN, SETPOINT, Port
from bus_schemas.tree import ROOT

PORT = IMPP.of("c1/inv07")
FOR_EVER_S = 100.0


@dataclass(frozen=True)
class Sample:
    """What an inbox takes from a sample: bytes that it does not look at."""

    payload: zenoh.ZBytes


def put(inbox: Inbox, *numbers: int, port: Port[Message] = PORT) -> None:
    """Let samples come on a port, as Zenoh calls the inbox."""
    hear = inbox.callback(port)
    for number in numbers:
        hear(cast(Any, Sample(zenoh.ZBytes(str(number)))))


def take(inbox: Inbox, wanted: int, timeout_s: float) -> list[int]:
    """What an inbox gives, as the numbers that came."""
    return [int(number) for _, number, _ in inbox.take(wanted, timeout_s)]


def test_a_rare_event_wakes_it_however_many_it_wants() -> None:
    inbox = Inbox()
    puts = threading.Thread(target=put, args=(inbox, 7), kwargs={"port": RUN.of(ROOT)})
    puts.start()
    assert take(inbox, 1000, FOR_EVER_S) == [7]
    puts.join()


def test_nothing_is_lost_or_turned_round_between_several_threads() -> None:
    inbox = Inbox()
    threads, each = 4, 500
    puts = [
        threading.Thread(target=put, args=(inbox, *range(thread * each, (thread + 1) * each)))
        for thread in range(threads)
    ]
    for thread in puts:
        thread.start()
    taken: list[int] = []
    while len(taken) < threads * each:
        taken += take(inbox, min(17, threads * each - len(taken)), FOR_EVER_S)
    for thread in puts:
        thread.join()
    assert sorted(taken) == list(range(threads * each))
    for number in range(threads):
        own = [found for found in taken if found // each == number]
        assert own == sorted(own)


def test_a_flood_of_one_port_is_bounded_and_counted_and_others_are_heard_through_it() -> None:
    inbox = Inbox()
    put(inbox, *range(50_000))
    put(inbox, -1, port=IMPP.of("c1/inv01"))
    put(inbox, *range(50_000))
    put(inbox, -2, port=SETPOINT.of("c1/inv01"))
    found = take(inbox, 1, timeout_s=0.0)
    assert len(found) < 11_000
    assert {-1, -2} <= set(found)
    assert inbox.dropped == {("c1/inv07/impp", "flooded"): 100_002 - len(found)}
    put(inbox, *range(5))
    assert take(inbox, 1, timeout_s=0.0) == [*range(5)], "there is room again"
