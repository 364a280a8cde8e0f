"""What processes take of the machine, tried in processes and threads of their own."""

from __future__ import annotations

import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest
from command_line import python

from agents.cycle import Kind
from agents.process.machine import (
    MachineSettings,
    own_memory_mb,
    refusals,
    stand_back,
    take_machine,
)
from agents.process.machine_watch import MachineWatch

Place = tuple[int, int, set[int]]


def place() -> Place:
    """Policy, priority and CPUs of this thread."""
    priority = os.sched_getparam(0).sched_priority
    return os.sched_getscheduler(0), priority, os.sched_getaffinity(0)


def taken(
    settings: MachineSettings, kind: Kind = "direct", *, lockstep: bool = False
) -> tuple[tuple[str, ...], Place]:
    """What a thread is refused, and its place then: the kernel keeps it thread by thread."""
    with ThreadPoolExecutor(1) as thread:
        refused = thread.submit(take_machine, settings, kind, lockstep=lockstep).result()
        return refused, thread.submit(place).result()


def test_a_process_runs_on_the_cpus_of_its_kind_or_of_all() -> None:
    first, last = min(os.sched_getaffinity(0)), max(os.sched_getaffinity(0))
    settings = MachineSettings(cpus=(first,), cpus_of={"plant": (last,)})
    assert taken(settings, "plant")[1][2] == {last}
    assert taken(settings, lockstep=True) == ((), (os.SCHED_BATCH, 0, {first}))


def test_priority_is_taken_where_the_machine_permits_it_and_what_is_refused_is_said() -> None:
    before = place()
    expected = refusals(MachineSettings(priority=7), lockstep=False)
    assert place() == before, "trying it leaves this process as it is"
    refused, found = taken(MachineSettings(priority=7))
    assert refused == expected
    assert found == before if refused else found[:2] == (os.SCHED_FIFO, 7)


@pytest.mark.skipif(os.geteuid() != 0, reason="privileges can be given up by root alone")
def test_without_permission_the_policy_stays_and_the_text_says_what_it_takes() -> None:
    """A process without privileges, and with a limit of 0, may not run first."""
    # Modules are imported before the privileges go: the folder may be closed to strangers.
    refused, policy = python(
        """
import os, resource, traceback
from agents.process.machine import MachineSettings, take_machine
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
os.setgroups([]); os.setgid(65534); os.setuid(65534)
print(take_machine(MachineSettings(priority=20), "direct", lockstep=False))
print(os.sched_getscheduler(0))
"""
    ).stdout.splitlines()
    assert "priority 20: the kernel refuses SCHED_FIFO (Operation not permitted)" in refused
    assert "`ulimit -r 20`" in refused
    assert policy == str(os.SCHED_OTHER)


def test_where_a_sandbox_forbids_the_policy_of_lockstep_a_process_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert taken(MachineSettings(), lockstep=True)[0] == ()


def test_only_the_thread_that_stands_back_does_so_and_gives_back_its_priority() -> None:
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with ThreadPoolExecutor(1) as thread:
        settings = MachineSettings(priority=7)
        refused = thread.submit(take_machine, settings, "recorder", lockstep=False).result()
        if not refused:
            assert thread.submit(place).result()[:2] == (os.SCHED_FIFO, 7)
        thread.submit(stand_back).result()
        assert thread.submit(place).result()[:2] == (os.SCHED_OTHER, 0)
        assert thread.submit(os.getpriority, os.PRIO_PROCESS, 0).result() == before + 5
    assert os.getpriority(os.PRIO_PROCESS, 0) == before


def test_timers_are_exact_in_real_time() -> None:
    done = python(
        "import ctypes; from agents.process.machine import *; "
        "take_machine(MachineSettings(), 'direct', lockstep=False); "
        "print(ctypes.CDLL(None).prctl(30))"  # PR_GET_TIMERSLACK
    )
    assert done.stdout == "1\n"


def test_memory_that_the_kernel_does_not_tell_ends_no_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert own_memory_mb() > 1.0

    def missing(path: Path, encoding: str | None = None) -> str:
        raise FileNotFoundError(path)

    monkeypatch.setattr(Path, "read_text", missing)
    assert own_memory_mb() == 0.0


# The watch ----------------------------------------------------------------------------------------


SLEEPS = 300


def test_a_time_in_which_the_watch_was_not_woken_is_a_stop_of_the_machine() -> None:
    with MachineWatch() as watch:
        process = psutil.Process(watch.process.pid)
        while process.num_ctx_switches().voluntary < SLEEPS:  # It does not sleep yet.
            time.sleep(0.01)
        began_ns = time.monotonic_ns()
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(0.2)
        os.kill(process.pid, signal.SIGCONT)
        longest = max(watch.stops(), key=lambda one: one.length_ms)
    assert longest.length_ms > 150.0
    assert longest.began_ns < began_ns + 200_000_000 < longest.ended_ns + 50_000_000
