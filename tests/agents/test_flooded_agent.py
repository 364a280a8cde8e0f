"""A flood of messages fills neither an agent's memory nor its log."""

from __future__ import annotations

import logging
import tracemalloc

import pytest
from msgspec.structs import replace
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import AtWork, telemetry

from agents.drop_log import log_drop
from agents.loop import AgentLoop
from agents.team import controller


def test_of_each_cycle_to_come_one_message_of_a_key_is_kept() -> None:
    plan = plan_of({"c1/a": 100.0}, period_cycles=(60, 10), cycles=100, cycle_wall_ns=REAL_TIME)
    work = AtWork(plan, "c1/a")
    tracemalloc.start()
    for number in range(20_000):
        work.loop.hear(*telemetry("c1/a", 1 + number % 61, 1.0), 0)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert grown < 1_000_000
    assert work.loop.dropped == {("c1/a/telemetry", "duplicate"): 20_000 - 61}


def test_a_flood_of_one_kind_does_not_hide_another_in_the_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    plan = plan_of({"c1/a": 100.0}, cycles=100, cycle_wall_ns=REAL_TIME)
    loop = AgentLoop(controller(plan, "c1/a"), plan, log_drop)
    loop.begin(0, 0)
    port, message = telemetry("c1/a", 0, 1.0)
    with caplog.at_level(logging.WARNING):
        for _ in range(10_000):
            loop.hear(port, message, 0)
        loop.hear(port, replace(message, source="central"), 0)
    assert 10 < len(caplog.records) < 40
    assert "is from 'central'" in caplog.records[-1].message
