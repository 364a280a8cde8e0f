"""Runs a program and watches all its processes from outside: processor time, how many there are."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from functools import partial
from typing import Final

import msgspec
import psutil

SAMPLE_S: Final = 0.2
LIMIT_S: Final = 300.0
_PR_SET_PDEATHSIG: Final = 1
_prctl: Final = ctypes.CDLL(None).prctl


class Failure(Exception):  # noqa: N818 - what failed is the program that was run
    """A program that did not end as it should, with what it said."""


class Sample(msgspec.Struct, frozen=True):
    """Processor time of all processes so far [s], at one moment of the monotonic clock [s]."""

    at: float
    processor_s: float
    processes: int


class Watched(msgspec.Struct, frozen=True):
    """A program that has ended: what it printed, when it was started, what was seen of it."""

    output: str
    started: float
    samples: list[Sample]

    def processor_ms(self, began: float, ended: float, cycles: int) -> float:
        """Return the processor time of all its processes for each cycle [ms].

        Of the time from `began` to `ended`, in which the cycles were run, the middle 60 % is used:
        start-up and end do not count. User and system time of the program and all its descendants.
        """
        edge = 0.2 * (ended - began)
        inside = [each for each in self.samples if began + edge <= each.at <= ended - edge]
        if len(inside) < 2:
            return float("nan")
        first, last = inside[0], inside[-1]
        rate = cycles / (ended - began)
        return 1e3 * (last.processor_s - first.processor_s) / (last.at - first.at) / rate

    @property
    def processes(self) -> int:
        return max((each.processes for each in self.samples), default=0)


def die_with_parent(number: int = signal.SIGKILL) -> None:
    """Have the kernel send this process a signal when its parent ends (Linux)."""
    _prctl(_PR_SET_PDEATHSIG, number)


def run(command: Sequence[str]) -> Watched:
    """Run a program to its end.

    It gets SIGTERM if this process ends before it, and is killed with its descendants if it takes
    too long.

    Raises
    ------
    Failure
        It failed, or took too long.
    """
    started = time.monotonic()
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        process_group=0,
        preexec_fn=partial(die_with_parent, signal.SIGTERM),  # noqa: PLW1509 - one thread here
    )
    samples: list[Sample] = []
    ended = threading.Event()
    sampler = threading.Thread(target=_sample, args=(process.pid, samples, ended))
    sampler.start()
    try:
        output, _ = process.communicate(timeout=LIMIT_S)
    except BaseException as error:
        _end(process)
        if isinstance(error, subprocess.TimeoutExpired):
            raise Failure(f"{command[1:3]} took over {LIMIT_S:g} s") from None
        raise
    finally:
        ended.set()
        sampler.join()
    if process.returncode:
        raise Failure(f"{' '.join(command)}\nended with status {process.returncode}:\n{output}")
    return Watched(output, started, samples)


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.communicate(timeout=20.0)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def _sample(pid: int, samples: list[Sample], ended: threading.Event) -> None:
    root = psutil.Process(pid)
    while not ended.wait(SAMPLE_S):
        processor_s, count = 0.0, 0
        try:
            for process in [root, *root.children(recursive=True)]:
                times = process.cpu_times()
                processor_s += times.user + times.system
                count += 1
        except psutil.NoSuchProcess:
            continue
        samples.append(Sample(time.monotonic(), processor_s, count))
