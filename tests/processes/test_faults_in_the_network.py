"""Processes over an imperfect network: what is lost is missed, named, recorded, and verified."""

from __future__ import annotations

import pytest
from running import Start
from test_launch import summary_of
from verifying import assert_equal_as_far_as_recorded, verified

from bus_schemas.messages import Message
from bus_schemas.missing import parse_missing
from bus_schemas.signals import Port, listeners
from bus_schemas.tree import RECORDER
from recordings.read.reader import RunReader

pytestmark = pytest.mark.processes

CYCLES = 20
FAULTS = ("--fault", "delay=5ms,jitter=4ms,loss=8%", "--fault", "signal=command,duplicate=10%")


def test_a_run_over_a_bad_network_verifies_equal_and_misses_what_the_rules_took(
    heliarch: Start, plant: str
) -> None:
    run = heliarch("launch", plant, "--pace", "4", "--duration", str(CYCLES), *FAULTS)
    run.wait()
    summary = summary_of(run.folder)
    # The plant ticks through all cycles, and says of each what it delivered.
    production = next(count for count in summary.messages if count.signal == "production")
    assert production.published == CYCLES
    assert summary.cycles == production.recorded
    assert summary.missing_inputs > 0
    assert set(summary.faults) == {"lost", "duplicated", "delayed"}
    found = verified(run.folder)
    assert_equal_as_far_as_recorded(run, found)
    assert found.total("missing_inputs") > 0
    with RunReader(run.folder) as reader:
        assert_missed(reader, list(reader.messages()))


def assert_missed(reader: RunReader, messages: list[tuple[Port[Message], Message]]) -> None:
    """Everything was recorded; whoever did not hear a message names it.

    In cycles that were skipped, on a machine that stood still, nothing was sent.
    """
    plan = reader.plan
    missing: dict[tuple[str, int], set[str]] = {}
    for _, message in messages:
        named = {parse_missing(entry).key for entry in message.missing}
        missing.setdefault((message.source, message.cycle), set()).update(named)
    lost = [
        (listener, message.cycle, str(port))
        for port, message in messages
        for listener in listeners(port, plan.tree)
        if listener != RECORDER
        and (listener, message.cycle) in missing
        and not plan.network_faults.fates(port, listener, message)
    ]
    assert lost
    assert [loss for loss in lost if loss[2] not in missing[loss[0], loss[1]]] == []
