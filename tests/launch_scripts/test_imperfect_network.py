"""Runs over an imperfect network, in memory on a virtual clock."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import done
from memory_runs import Sent, run_with, timeless

from bus_schemas.codec import encode
from bus_schemas.faults import Disturbance
from bus_schemas.signals import COMMAND
from launch_scripts.simulation import MemoryRun
from scenarios.preparation import Preparation, RunOptions, prepare
from scenarios.scenario import load_scenario

CYCLES = 20
MS = 1_000_000
SECOND_NS = 1_000 * MS


@pytest.fixture(scope="module")
def valley() -> Preparation:
    """60 inverters in four tiers."""
    return prepare(load_scenario("valley"), RunOptions(duration=str(CYCLES)), "faults")


def decisions(sent: Sent) -> list[tuple[str, bytes]]:
    """What agents decided, in the order of cycle and key, without times."""
    found = [
        (message.cycle, str(port), encode(timeless(message)))
        for port, message in sent.messages
        if port.signal.decided
    ]
    return [(key, data) for _, key, data in sorted(found)]


def missed(run: MemoryRun) -> int:
    """Inputs that were not there at a deadline."""
    return sum(loop.inputs.missing for loop in run.loops.values())


# What changes nothing -----------------------------------------------------------------------------


@pytest.mark.parametrize(("scheme", "periods"), [("paper", (1, 1, 1)), ("predictive", (6, 2, 1))])
def test_delays_within_the_cycle_change_nothing_but_the_time(
    valley: Preparation, scheme: str, periods: tuple[int, ...]
) -> None:
    changes: dict[str, Any] = {"scheme": scheme, "period_cycles": periods}
    # As long as one stage of the cycle: each message comes exactly at the deadline.
    hop_ms = 900.0 / 8
    run, sent = run_with(valley, [Disturbance(delay_ms=hop_ms)], **changes)
    assert missed(run) == 0
    assert decisions(sent) == decisions(run_with(valley, (), **changes)[1])
    leaf, hops_before = valley.plan.tree.leaves[0], 2 * valley.plan.tree.height + 1
    took_ns = round(hops_before * hop_ms * MS)
    assert sent.of(COMMAND.of(leaf))[6].publish_time_ns == 6 * SECOND_NS + took_ns


# Controllers that are slow, or never answer -------------------------------------------------------


# As a user asks for it ----------------------------------------------------------------------------


def test_a_silence_is_in_simulated_time_at_any_pace_and_a_rule_without_messages_is_named(
    tmp_path: Path,
) -> None:
    faults = ("--fault", "signal=impp,blackout=2s..4s", "--fault", "blackout=50s..60s")
    words = ("--duration", "5", "--pace", "5", "--json", tmp_path / "s.json", *faults)
    output = " ".join(done("simulate", "oahu", *words, "--out", tmp_path / "run").split())
    summary = json.loads((tmp_path / "s.json").read_text())
    assert summary["missing_inputs"] == 2 * (17 + 3)
    assert "never acted" in output
