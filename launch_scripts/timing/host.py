"""The machine and the software that a timing was measured with: figures mean nothing without."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

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
        Scheduling policies and processors that the processes of the run really had.
    load_before, load_after
        Processes that were running or waiting to, averaged over the last minute (load average).
    python, heliarch, zenoh
        Versions.
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


def host(timings: Iterable[ProcessTiming], load_before: float) -> Host:
    """Return the facts, after a run."""
    uname = platform.uname()
    return Host(
        kernel=f"{uname.system} {uname.release} {uname.version}",
        cpu=cpu_model(),
        cpus=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0,
        policies=tuple(sorted({timing.policy for timing in timings})),
        load_before=load_before,
        load_after=load_average(),
        python=platform.python_version(),
        heliarch=version("heliarch"),
        zenoh=version("eclipse-zenoh"),
    )


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
