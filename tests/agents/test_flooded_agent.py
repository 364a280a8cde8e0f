"""A flood of messages fills neither an agent's memory nor its log."""

from __future__ import annotations

import logging
import tracemalloc

import pytest

from agents.direct import DirectController
from agents.drop_log import DropLog
from agents.periods import Periods
from agents.sequencer import Sequencer
from bus_schemas.messages import Telemetry
from bus_schemas.signals import TELEMETRY

NODE = "c1/inv07"


def telemetry(cycle: int) -> Telemetry:
    return Telemetry(cycle, cycle, "plant", (), power_kw=1.0, alpha=1.0, limit_kw=470.0)


def test_of_each_cycle_to_come_one_message_of_a_key_is_kept() -> None:
    controller = DirectController(NODE, 470.0, 0.05, Periods((60, 10)), "paper", "fraction")
    sequencer = Sequencer(controller, lambda cycle: cycle, lockstep=False, horizon=60)
    sequencer.enter(0)
    tracemalloc.start()
    for number in range(50_000):
        sequencer.accept(TELEMETRY.of(NODE), telemetry(1 + number % 60))
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert grown < 1_000_000
    assert sequencer.drops.duplicate == 50_000 - 60


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
