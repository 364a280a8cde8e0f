"""Processes over an imperfect network: what is lost is missed, named, recorded, and verified."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest
from running import Heliarch, assert_none_left

from bus_schemas.messages import Message
from bus_schemas.signals import Port, listeners
from bus_schemas.tree import RECORDER
from launch_scripts.verification.comparison import Comparison
from launch_scripts.verification.verification import verify
from recordings.reader import RunReader

pytestmark = pytest.mark.processes

FAULTS = ("--fault", "delay=5ms,jitter=4ms,loss=4%", "--fault", "signal=command,duplicate=10%")


def test_a_run_over_a_bad_network_verifies_equal_and_misses_what_the_rules_took(
    heliarch: Callable[..., Heliarch],
) -> None:
    run = heliarch("launch", "oahu", "--pace", "5", "--duration", "20", *FAULTS)
    assert run.wait() == 0, run.error_text()
    summary = msgspec.json.decode((run.folder / "summary.json").read_bytes())
    assert summary["cycles"] == 20
    assert summary["missing_inputs"] > 0
    assert set(summary["faults"]) == {"lost", "duplicated", "delayed"}
    found = verify(run.folder, (), Comparison())
    assert {name: entry.first for name, entry in found.accounts.items() if entry.first} == {}
    assert found.missed_inputs > 0
    assert_none_left(run.folder)
    with RunReader(run.folder) as reader:
        assert_missed(reader, list(reader.messages()))


def assert_missed(reader: RunReader, messages: list[tuple[Port[Message], Message]]) -> None:
    """Everything was recorded; whoever did not hear a message does not say that he had it."""
    plan = reader.plan
    missing: dict[tuple[str, int], set[str]] = {}
    for _, message in messages:
        named = {entry.partition("@")[0] for entry in message.missing}
        missing.setdefault((message.source, message.cycle), set()).update(named)
    lost = [
        (listener, message.cycle, str(port))
        for port, message in messages
        for listener in listeners(port, plan.tree)
        if listener != RECORDER and not plan.network_faults.fates(port, listener, message)
    ]
    assert lost
    unnoticed = [loss for loss in lost if loss[2] not in missing.get((loss[0], loss[1]), set())]
    # A call for help is looked for only where its residual, which may be lost too, announced it.
    assert [loss for loss in unnoticed if not loss[2].endswith("/help")] == []
