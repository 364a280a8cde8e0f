"""The header says what the processes took of the machine, and what they were refused."""

from __future__ import annotations

import pytest
from msgspec.structs import replace
from timed_recordings import PLAN

from agents.machine import MachineSettings
from studies.timing.host import recorded_host, this_host

REFUSED = ("priority 20: the kernel refuses SCHED_FIFO (not permitted)",)


@pytest.mark.parametrize(
    ("machine", "remarks", "scheduling"),
    [
        (MachineSettings(), (), "normal"),
        (MachineSettings(priority=20), (), "SCHED_FIFO 20"),
        (MachineSettings(priority=20), REFUSED, "normal"),
        (MachineSettings(cpus=(0, 1)), (), "normal, all on CPU 0, 1"),
        (
            MachineSettings(cpus=(0,), cpus_of={"direct": (1,)}, priority=7),
            (),
            "SCHED_FIFO 7, direct on CPU 1, others on CPU 0",
        ),
    ],
)
def test_scheduling_is_what_was_asked_for_and_not_refused(
    machine: MachineSettings, remarks: tuple[str, ...], scheduling: str
) -> None:
    plan = replace(PLAN, machine=machine)
    assert this_host(plan, remarks, 0.5).scheduling == scheduling
    assert recorded_host(plan, remarks, {}).scheduling == scheduling


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
    plan = replace(PLAN, machine=MachineSettings(lock_memory=asked))
    assert this_host(plan, remarks, 0.5).memory_locked is locked


def test_of_a_recording_the_machine_is_that_of_its_metadata() -> None:
    found = recorded_host(PLAN, (), {"kernel": "6.18", "cpu_count": "4", "python": "3.11"})
    assert (found.kernel, found.cpus, found.python) == ("6.18", 4, "3.11")
    assert found.load_before is None
