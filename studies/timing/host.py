"""The machine and the software that a timing was measured with: figures mean nothing without."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from agents.plan import RunPlan

_CPU_FACTS: Final = Path("/proc/cpuinfo")


class Host(msgspec.Struct, frozen=True):
    """What a timing was measured on.

    Attributes
    ----------
    kernel, cpu
        Name and release of the kernel, model of the processor; empty if it is not known.
    cpus
        Number of processors that the run could use.
    scheduling
        What plant and controllers took of the machine: `SCHED_FIFO 20`.
    load_before, load_after
        Processes that were running or waiting to, averaged over the last minute (load average);
        None if it is not known.
    python, heliarch, zenoh
        Versions.
    memory_locked
        Whether the memory of plant and controllers was never paged out.
    """

    kernel: str
    cpu: str
    cpus: int
    scheduling: str
    load_before: float | None
    load_after: float | None
    python: str
    heliarch: str
    zenoh: str
    memory_locked: bool = False


def this_host(plan: RunPlan, remarks: Iterable[str], load_before: float) -> Host:
    """Return what this machine is, after a run on it.

    Parameters
    ----------
    plan, remarks
        Of the run: what the machine did not permit is among the remarks.
    load_before
        See `Host`.
    """
    uname = platform.uname()
    refused = list(remarks)
    return Host(
        kernel=f"{uname.system} {uname.release} {uname.version}",
        cpu=cpu_model(),
        cpus=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0,
        scheduling=scheduling(plan, refused),
        load_before=load_before,
        load_after=load_average(),
        python=platform.python_version(),
        heliarch=version("heliarch"),
        zenoh=version("eclipse-zenoh"),
        memory_locked=memory_locked(plan, refused),
    )


def recorded_host(plan: RunPlan, remarks: Iterable[str], run: Mapping[str, str]) -> Host:
    """Return what a recording says of the machine that it was made on.

    Parameters
    ----------
    plan, remarks
        See `this_host`.
    run
        The recording's metadata of that name.
    """
    refused = list(remarks)
    return Host(
        kernel=run.get("kernel", ""),
        cpu="",
        cpus=int(run.get("cpu_count", "0")),
        scheduling=scheduling(plan, refused),
        load_before=None,
        load_after=None,
        python=run.get("python", ""),
        heliarch=run.get("version heliarch", ""),
        zenoh=run.get("version eclipse-zenoh", ""),
        memory_locked=memory_locked(plan, refused),
    )


def scheduling(plan: RunPlan, remarks: Iterable[str]) -> str:
    """Say what plant and controllers asked of the scheduler and were not refused."""
    machine, refused = plan.machine, tuple(remarks)
    fifo = machine.priority and not any("SCHED_FIFO" in remark for remark in refused)
    policy = f"SCHED_FIFO {machine.priority}" if fifo else "normal"
    bound = [f"{kind} on CPU {_listed(cpus)}" for kind, cpus in machine.cpus_of.items()]
    if machine.cpus:
        others = "others" if bound else "all"
        bound.append(f"{others} on CPU {_listed(machine.cpus)}")
    return ", ".join([policy, *bound])


def memory_locked(plan: RunPlan, remarks: Iterable[str]) -> bool:
    """Return whether memory was to be locked, and the machine permitted it."""
    refused = any(remark.startswith("memory: ") for remark in remarks)
    return plan.machine.lock_memory and not refused


def load_average() -> float:
    """Return the load average of the last minute."""
    return os.getloadavg()[0]


def cpu_model() -> str:
    """Return the model of the processor, as the kernel names it."""
    try:
        lines = _CPU_FACTS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


def _listed(cpus: Iterable[int]) -> str:
    return ", ".join(map(str, cpus))
