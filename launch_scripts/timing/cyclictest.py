"""`cyclictest` of rt-tests, where it is installed: the machine's floor as Linux people know it."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from math import ceil
from pathlib import Path
from typing import Final

import msgspec
from hdrh.histogram import HdrHistogram

from agents.histograms import new_histogram
from agents.machine import MachineSettings
from launch_scripts.processes import environment

_LONGEST_US: Final = 100_000
"""What its histogram reaches to; what is later is only in its maximum."""

_PATIENCE_S: Final = 2.0

_LONGER_S: Final = 60
"""By so much it may outlast the run, whatever becomes of who should end it."""


class _Thread(msgspec.Struct):
    histogram: dict[str, int]
    cycles: int
    max: int


class _Results(msgspec.Struct):
    thread: dict[str, _Thread]


class Cyclictest:
    """A run of cyclictest beside the plant, with one thread at the plant's rate.

    It is told not to tune the system, so that it measures the machine that the plant has.

    Parameters
    ----------
    period_ns
        Length of a cycle.
    machine
        What the controllers of the run take of the machine: it takes the same.
    """

    def __init__(self, period_ns: int, machine: MachineSettings) -> None:
        self._period_us = max(round(period_ns / 1e3), 1)
        self._policy = ["--policy=other"]
        if machine.priority:
            self._policy = ["--policy=fifo", f"--priority={machine.priority}"]
        cpus = machine.cpus_of.get("direct", machine.cpus)
        self._affinity = [f"--affinity={','.join(map(str, cpus))}"] if cpus else []
        self._program = shutil.which("cyclictest")
        self._folder = tempfile.TemporaryDirectory()
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def installed(self) -> bool:
        """Whether there is a cyclictest on this machine."""
        return self._program is not None

    def begin(self, duration_s: float) -> None:
        """Start it; it goes on until `finish`, for not much longer than so long at most.

        It dies with this process too, however that ends.
        """
        if self._program is None:
            return
        command = [
            *(sys.executable, "-P", "-m", "agents.parent_death", f"{os.getpid()}"),
            self._program,
            f"--duration={ceil(duration_s) + _LONGER_S}",
            *("--quiet", "--default-system", "--threads=1", *self._policy, *self._affinity),
            *(f"--interval={self._period_us}", f"--histogram={_LONGEST_US}"),
            f"--json={self._results}",
        ]
        self._process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment(),
            process_group=0,
        )

    def finish(self) -> HdrHistogram | None:
        """End it; return how late it woke, None where it could not run."""
        if self._process is None:
            return None
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(_PATIENCE_S)
            return latencies(self._results.read_bytes())
        except (subprocess.TimeoutExpired, OSError, msgspec.DecodeError):
            return None

    def end(self) -> None:
        """Make sure that nothing of it is left."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    @property
    def _results(self) -> Path:
        return Path(self._folder.name) / "cyclictest.json"


def latencies(document: bytes) -> HdrHistogram:
    """Return its histogram in nanoseconds. What was beyond its reach counts as its maximum."""
    total = new_histogram()
    for thread in msgspec.json.decode(document, type=_Results).thread.values():
        for latency_us, count in thread.histogram.items():
            total.record_value(int(latency_us) * 1_000, count)
        beyond = thread.cycles - sum(thread.histogram.values())
        if beyond > 0:
            total.record_value(thread.max * 1_000, beyond)
    return total
