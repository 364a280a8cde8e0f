"""The machine and the software that a timing was measured with: figures mean nothing without."""

from __future__ import annotations

import os
import platform
from collections import defaultdict
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from agents.kinds import KINDS, kind_of
from agents.plan import RunPlan
from agents.stopwatch import ProcessTiming

_CPU_FACTS: Final = Path("/proc/cpuinfo")


class Host(msgspec.Struct, frozen=True):
    """What a timing was measured on.

    Attributes
    ----------
    kernel, cpu
        Name and release of the kernel, model of the processor.
    cpus
        Number of processors that this command may use.
    policies
        Scheduling policies and processors that the processes of the run really had; where they
        differ, with the kinds of processes that had them: `direct: fifo 20 on CPU 1`.
    load_before, load_after
        Processes that were running or waiting to, averaged over the last minute (load average).
    python, heliarch, zenoh
        Versions.
    memory_locked
        Whether the memory of plant and controllers was never paged out.
    """

    kernel: str
    cpu: str
    cpus: int
    policies: tuple[str, ...]
    load_before: float
    load_after: float
    python: str
    heliarch: str
    zenoh: str
    memory_locked: bool = False


def host(
    timings: Sequence[ProcessTiming], plan: RunPlan, remarks: Iterable[str], load_before: float
) -> Host:
    """Return the facts, after a run.

    Parameters
    ----------
    timings
        What its processes measured of themselves.
    plan
        Of the run.
    remarks
        Of the run: what the machine did not permit is among them.
    load_before
        See `Host`.
    """
    refused = any(remark.startswith("memory: not locked") for remark in remarks)
    uname = platform.uname()
    return Host(
        kernel=f"{uname.system} {uname.release} {uname.version}",
        cpu=cpu_model(),
        cpus=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0,
        policies=policies(timings, plan),
        load_before=load_before,
        load_after=load_average(),
        python=platform.python_version(),
        heliarch=version("heliarch"),
        zenoh=version("eclipse-zenoh"),
        memory_locked=plan.machine.lock_memory and not refused,
    )


def policies(timings: Iterable[ProcessTiming], plan: RunPlan) -> tuple[str, ...]:
    """Return the policies of the processes, with the kinds that had them if they differ."""
    kinds: dict[str, set[str]] = defaultdict(set)
    for timing in timings:
        kinds[timing.policy].add(kind_of(timing.agent, plan.tree))
    if len(kinds) <= 1:
        return tuple(kinds)
    by_kind = {policy: sorted(members, key=KINDS.index) for policy, members in kinds.items()}
    in_order = sorted(by_kind, key=lambda policy: (KINDS.index(by_kind[policy][0]), policy))
    return tuple(f"{', '.join(by_kind[policy])}: {policy}" for policy in in_order)


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
