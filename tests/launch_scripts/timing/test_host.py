"""The header says which kinds of processes had which scheduling, and what was locked."""

from __future__ import annotations

import pytest
from msgspec.structs import replace
from timings_by_hand import REAL_TIME, TIMINGS

from agents.machine import MachineSettings
from launch_scripts.timing.host import host, policies


def test_one_policy_for_all_needs_no_names() -> None:
    assert policies(TIMINGS, REAL_TIME) == ("other on CPU 0, 1",)


def test_where_policies_differ_the_kinds_that_had_them_are_named() -> None:
    fifo = {"plant": "fifo 20 on CPU 0", "central": "fifo 20 on CPU 0"}
    mixed = [replace(timing, policy=fifo.get(timing.agent, timing.policy)) for timing in TIMINGS]
    assert policies(mixed, REAL_TIME) == (
        "plant, central: fifo 20 on CPU 0",
        "supervisor, direct: other on CPU 0, 1",
    )


@pytest.mark.parametrize(
    ("asked", "remarks", "locked"),
    [
        (True, (), True),
        (True, ("memory: not locked (not permitted); it takes CAP_IPC_LOCK",), False),
        (False, (), False),
    ],
)
def test_locked_memory_is_what_was_asked_for_and_permitted(
    asked: bool, remarks: tuple[str, ...], locked: bool
) -> None:
    plan = replace(REAL_TIME, machine=MachineSettings(lock_memory=asked))
    assert host(TIMINGS, plan, remarks, 0.5).memory_locked is locked
