"""The host says what the processes took of the machine, less what they were refused."""

from __future__ import annotations

import pytest
from msgspec.structs import replace
from timed_recordings import PLAN

from agents.machine import MachineSettings
from studies.timing.host import Host, host_of

REFUSED = ("priority 20: the kernel refuses SCHED_FIFO (not permitted)",)
NOT_LOCKED = ("memory: not locked (not permitted); it takes CAP_IPC_LOCK",)


def host(machine: MachineSettings, remarks: tuple[str, ...] = ()) -> Host:
    return host_of(
        replace(PLAN, machine=machine), {"kernel": "6.18", "cpu_count": "4"}, remarks, None
    )


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
    assert host(machine, remarks).scheduling == scheduling


def test_locked_memory_is_what_was_asked_for_and_permitted() -> None:
    locked = MachineSettings(lock_memory=True)
    assert host(locked).memory_locked
    assert not host(locked, NOT_LOCKED).memory_locked
    assert not host(MachineSettings()).memory_locked


def test_the_machine_is_that_of_the_recording() -> None:
    found = host(MachineSettings())
    assert (found.kernel, found.cpus, found.load_before) == ("6.18", 4, None)
