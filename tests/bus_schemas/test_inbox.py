"""The queue between the bus's threads and an agent's: wakes it when there is enough to do."""

from __future__ import annotations

import threading
import time
from typing import cast

import zenoh

from bus_schemas.zenoh_bus import Inbox


def sample(number: int) -> zenoh.Sample:
    """Something to put into an inbox, which does not look at it."""
    return cast("zenoh.Sample", number)


def take(inbox: Inbox, wanted: int, timeout_s: float | None) -> list[int]:
    """What an inbox gives, as the numbers that were put into it."""
    return [cast("int", number) for _, number in inbox.take(wanted, timeout_s)]


def in_threads(*works: threading.Thread) -> None:
    for work in works:
        work.start()


def test_what_is_there_already_is_taken_at_once_in_its_order() -> None:
    inbox = Inbox()
    for number in range(3):
        inbox.put(sample(number))
    assert take(inbox, 2, timeout_s=None) == [0, 1, 2]


def test_what_was_taken_is_gone() -> None:
    inbox = Inbox()
    inbox.put(sample(1))
    assert take(inbox, 1, timeout_s=None) == [1]
    assert take(inbox, 1, timeout_s=0.0) == []


def test_at_the_time_out_whatever_is_there_is_taken() -> None:
    inbox = Inbox()
    inbox.put(sample(1))
    began_s = time.monotonic()
    assert take(inbox, 2, timeout_s=0.02) == [1]
    assert time.monotonic() - began_s >= 0.02


def test_a_time_out_that_has_passed_does_not_wait() -> None:
    assert take(Inbox(), 1, timeout_s=-1.0) == []


def test_a_waiting_agent_is_woken_by_the_last_sample_that_it_wants() -> None:
    inbox = Inbox()

    def put_all() -> None:
        for number in range(3):
            inbox.put(sample(number))

    puts = threading.Thread(target=put_all)
    in_threads(puts)
    # Without a time-out: if the third one did not wake it, this would wait for ever.
    assert take(inbox, 3, timeout_s=None) == [0, 1, 2]
    puts.join()


def test_samples_that_come_between_two_waits_do_not_wake_the_second_too_soon() -> None:
    inbox = Inbox()
    inbox.put(sample(0))
    assert take(inbox, 1, timeout_s=None) == [0]
    inbox.put(sample(1))
    inbox.put(sample(2))
    puts = threading.Thread(target=inbox.put, args=(sample(3),))
    in_threads(puts)
    assert take(inbox, 3, timeout_s=None) == [1, 2, 3]
    puts.join()


def test_nothing_is_lost_or_turned_round_between_several_threads() -> None:
    inbox = Inbox()
    threads, each = 4, 500

    def put_all(thread: int) -> None:
        for number in range(each):
            inbox.put(sample(thread * each + number))

    puts = [threading.Thread(target=put_all, args=(thread,)) for thread in range(threads)]
    in_threads(*puts)
    taken: list[int] = []
    while len(taken) < threads * each:
        wanted = min(17, threads * each - len(taken))
        taken += take(inbox, wanted, timeout_s=None)
    for put in puts:
        put.join()
    assert sorted(taken) == list(range(threads * each))
    for thread in range(threads):
        own = [number for number in taken if number // each == thread]
        assert own == sorted(own)


def test_an_agent_that_wants_one_at_a_time_gets_them_all() -> None:
    inbox = Inbox()
    replies = threading.Semaphore(0)

    def put_one_after_the_other() -> None:
        for number in range(200):
            inbox.put(sample(number))
            replies.acquire()

    puts = threading.Thread(target=put_one_after_the_other)
    in_threads(puts)
    taken: list[int] = []
    while len(taken) < 200:
        got = take(inbox, 1, timeout_s=None)
        taken += got
        for _ in got:
            replies.release()
    puts.join()
    assert taken == list(range(200))
