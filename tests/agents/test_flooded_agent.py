"""A flood of messages fills neither an agent's memory nor its log."""

from __future__ import annotations

import logging
import tracemalloc

import pytest
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import AtWork, telemetry

from agents.drop_log import DropLog


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
    drop_log = DropLog()
    with caplog.at_level(logging.WARNING):
        for cycle in range(100_000):
            drop_log(f"c1/inv07/impp of cycle {cycle} came twice")
        drop_log("c1/inv07/impp of cycle 7 is from 'central'")
    assert drop_log.total == 100_001
    assert len(caplog.records) < 40
    assert "is from 'central'" in caplog.records[-1].message


def test_kinds_without_end_do_not_fill_the_log(caplog: pytest.LogCaptureFixture) -> None:
    drop_log = DropLog()
    with caplog.at_level(logging.WARNING):
        for number in range(5000):
            drop_log("x" * number + " is of a node that this run does not have")
    assert len(caplog.records) < 300
