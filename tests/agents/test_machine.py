"""What processes take of the machine, tried in processes and threads of their own."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import TypeVar

import pytest
from command_line import python

from agents.cycle import Kind
from agents.machine import (
    MachineSettings,
    refusals,
    scheduling_policy,
    stand_back,
    take_machine,
)

T = TypeVar("T")


def in_a_thread(work: Callable[[], T]) -> T:
    """Do something in a thread of its own: the kernel keeps policy and CPUs thread by thread."""
    results: list[T] = []
    thread = threading.Thread(target=lambda: results.append(work()))
    thread.start()
    thread.join()
    return results[0]


def place_of(
    settings: MachineSettings, kind: Kind = "direct", *, lockstep: bool = False
) -> tuple[tuple[str, ...], str]:
    """Return what was refused, and policy and CPUs as the kernel has them then."""
    return in_a_thread(
        lambda: (take_machine(settings, kind, lockstep=lockstep), scheduling_policy())
    )


def lines_of(code: str) -> list[str]:
    """Run Python code in a process of its own; return the lines that it prints."""
    done = python(f"from agents.machine import *\n{code}")
    return done.stdout.splitlines()


def test_a_process_runs_on_the_cpus_of_its_kind_or_of_all() -> None:
    first, last = min(os.sched_getaffinity(0)), max(os.sched_getaffinity(0))
    settings = MachineSettings(cpus=(first,), cpus_of={"plant": (last,)})
    assert place_of(settings, "plant")[1].endswith(f" on CPU {last}")
    refused, policy = place_of(settings, lockstep=True)
    assert refused == ()
    assert policy.startswith("batch")
    assert policy.endswith(f" on CPU {first}")


def test_a_cpu_that_is_not_there_is_said_and_the_process_goes_on() -> None:
    (refused,), policy = place_of(MachineSettings(cpus=(1023,)))
    assert refused.startswith("CPU 1023: not available (")
    assert policy == scheduling_policy()


def test_priority_is_taken_where_the_machine_permits_it_and_what_is_refused_is_said() -> None:
    before = scheduling_policy()
    expected = refusals(MachineSettings(priority=7), lockstep=False)
    assert scheduling_policy() == before, "trying it leaves this process as it is"
    refused, policy = place_of(MachineSettings(priority=7))
    assert refused == expected
    assert policy == before if refused else policy.startswith("fifo 7")


# Modules are imported before the privileges go: the folder may be closed to strangers.
GIVE_UP = """
import os, resource, traceback
os.setgroups([]); os.setgid(65534); os.setuid(65534)
"""
root = pytest.mark.skipif(os.geteuid() != 0, reason="privileges can be given up by root alone")


@root
def test_without_permission_the_policy_stays_and_the_text_says_what_it_takes() -> None:
    """A process without privileges, and with a limit of 0, may not run first."""
    refused, policy = lines_of(
        f"""
import resource
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
{GIVE_UP}
print(take_machine(MachineSettings(priority=20), "direct", lockstep=False))
print(scheduling_policy())
"""
    )
    assert "priority 20: the kernel refuses SCHED_FIFO (Operation not permitted)" in refused
    assert "`ulimit -r 20`" in refused
    assert policy.startswith("other")


def test_only_the_thread_that_stands_back_does_so() -> None:
    def priority_aside() -> int:
        stand_back()
        return os.getpriority(os.PRIO_PROCESS, 0)

    before = os.getpriority(os.PRIO_PROCESS, 0)
    assert in_a_thread(priority_aside) == before + 5
    assert os.getpriority(os.PRIO_PROCESS, 0) == before


def test_timers_are_exact_in_real_time() -> None:
    code = (
        "import ctypes; take_machine(MachineSettings(), 'direct', lockstep=False); "
        "print(ctypes.CDLL(None).prctl(30))"  # PR_GET_TIMERSLACK
    )
    assert lines_of(code) == ["1"]
