"""Processors, scheduling and memory of a process."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from agents.cycle import Kind
from bus_schemas.errors import InputError

LOWEST_PRIORITY: Final = 1
HIGHEST_PRIORITY: Final = 99
"""Of the policy SCHED_FIFO, see sched(7)."""

_RECORDER_NICE: Final = 5
"""In real time the recorder may write later: its messages wait in a queue, and lose nothing."""

_SET_PARENT_DEATH_SIGNAL: Final = 1
"""PR_SET_PDEATHSIG of prctl(2). It outlives execve(2)."""

_SET_TIMER_SLACK: Final = 29
"""PR_SET_TIMERSLACK of prctl(2)."""

_FILES: Final = 40
"""Open files of a process beside its links."""


class MachineSettings(msgspec.Struct, frozen=True):
    """What the processes of a run may take of the machine. By default nothing special.

    cpus, cpus_of: Processors that all processes run on, and those of one kind. Empty: any.
    priority: In real time: of plant, controllers and what receives for the recorder under
        SCHED_FIFO, 1 to 99. 0: normal policy.
    """

    cpus: tuple[int, ...] = ()
    cpus_of: dict[Kind, tuple[int, ...]] = {}
    priority: int = 0


def take_machine(settings: MachineSettings, kind: Kind, *, lockstep: bool) -> tuple[str, ...]:
    """Set this process up as the settings say, before it opens the bus, which starts threads.

    Returns what the machine does not permit, and why: the process goes on without it.
    """
    refused = []
    if cpus := settings.cpus_of.get(kind, settings.cpus):
        try:
            os.sched_setaffinity(0, cpus)
        except OSError as error:
            refused.append(f"CPU {', '.join(map(str, cpus))}: not available ({error.strerror})")
    if lockstep:
        # Do not interrupt the running process when woken: it may have more messages to send.
        with suppress(OSError):  # A sandbox may forbid it; it only saves processor time.
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    else:
        wake_precisely()
        priority = settings.priority
        try:
            if priority:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except OSError as error:
            refused.append(
                f"priority {priority}: the kernel refuses SCHED_FIFO ({error.strerror}); it needs "
                f"CAP_SYS_NICE, or `ulimit -r {priority}`"
            )
    return tuple(refused)


def refusals(settings: MachineSettings, *, lockstep: bool) -> tuple[str, ...]:
    """Return what this machine would not permit to a controller, by trying it in a thread."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(take_machine, settings, "direct", lockstep=lockstep).result()


def wake_precisely() -> None:
    """Ask the kernel to wake this thread on time: by default Linux adds up to 50 µs."""
    ctypes.CDLL(None).prctl(_SET_TIMER_SLACK, 1)


def take_files(processes: int) -> None:
    """Let this process open a file for each process of a run."""
    needed = _FILES + processes
    allowed, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if resource.RLIM_INFINITY in {allowed, most} or needed <= allowed:
        return
    if needed > most:
        text = f"expected at least {needed} for {processes} processes, got {most}"
        raise InputError(f"open files of a process (ulimit -n): {text}")
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, most))


def own_memory_mb() -> float:
    """Return the memory of this process that it shares with no other [MB]; 0: not known."""
    try:
        lines = Path("/proc/self/smaps_rollup").read_text(encoding="ascii").splitlines()
    except OSError:  # A kernel may be built without it, and a container may hide it.
        return 0.0
    return 1.024e-3 * sum(int(line.split()[1]) for line in lines if line.startswith("Private_"))


def die_with_parent(death_signal: signal.Signals = signal.SIGKILL) -> None:
    """Ask the kernel for a signal when the parent of this process dies."""
    ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, int(death_signal))


def stand_back() -> None:
    """Lower the priority of this thread, but not of the threads that receive messages."""
    with suppress(OSError):  # A sandbox may forbid it, and then gave no priority either.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.setpriority(os.PRIO_PROCESS, 0, os.getpriority(os.PRIO_PROCESS, 0) + _RECORDER_NICE)
