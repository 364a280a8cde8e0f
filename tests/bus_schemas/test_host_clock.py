"""The clock of another host, as the messages that come from there tell it."""

from __future__ import annotations

import random

from bus_schemas.host_clock import CLOCK_BYTES, HostClock

MS, S = 1_000_000, 1_000_000_000
AHEAD = 432_000 * S


def test_a_drifting_clock_is_followed_to_the_shortest_time_on_the_way() -> None:
    for drift in (-50e-6, 0.0, 50e-6):
        hops_ms, clock, before = random.Random(1), HostClock(), 0
        for published in range(S, 3_600 * S, S):
            came = published + round(hops_ms.choice((20.0, 25.0, 300.0)) * MS)
            shown = round(came * (1.0 + drift)) + AHEAD
            clock.observe(published, shown)
            assert before <= clock.at(shown) <= came - 20 * MS
            before = clock.at(shown)
            if published > 30 * S:
                assert came - before < 25 * MS


def test_the_clock_shows_the_hosts_time_until_a_timed_message_comes() -> None:
    clock = HostClock()
    clock.observe(0, AHEAD)
    assert clock.at(AHEAD) == AHEAD
    clock.observe(7 * S, AHEAD)
    assert clock.at(AHEAD) == 7 * S


def test_the_processes_of_a_host_share_one_clock_which_the_fastest_message_sets() -> None:
    memory = memoryview(bytearray(CLOCK_BYTES)).cast("q")
    first, second = HostClock(memory), HostClock(memory)
    first.observe(7 * S, AHEAD + 20 * MS)
    assert second.at(AHEAD + 20 * MS) == 7 * S
    second.observe(8 * S, AHEAD + S + 2 * MS)
    assert first.at(AHEAD + S + 2 * MS) == second.at(AHEAD + S + 2 * MS) == 8 * S
