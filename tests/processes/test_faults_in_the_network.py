"""Processes over an imperfect network: what is lost is missed, named, recorded, and verified."""

from __future__ import annotations

import pytest
from running import Start
from test_launch import summary_of
from verifying import assert_equal_as_far_as_recorded, verified

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
