"""Runs a program, `heliarch launch` above all, and watches all its processes from outside."""

from __future__ import annotations

import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from math import nan
from pathlib import Path
from typing import Any, Final

import msgspec
import psutil

OURS: Final = Path(sys.executable).parent / "heliarch"
SAMPLE_S: Final = 0.2
LIMIT_S: Final = 300.0


class Sample(msgspec.Struct, frozen=True):
    """Processor time of all processes so far [s], at one moment of the monotonic clock [s]."""

    at: float
    processor_s: float


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """What a run of a control graph came to, seen from outside.

    startup_s: From the command to cycle 0.
    processor_ms: User and system time of all its processes for each cycle.
    """

    cycles_per_s: float
    startup_s: float
    processor_ms: float
    lost: int


class Watched(msgspec.Struct, frozen=True):
    """A program that has ended: what it printed, when it was started, what was seen of it."""

    output: str
    started: float
    samples: list[Sample]

    def figures(self, began: float, ended: float, cycles: int, lost: int = 0) -> Figures:
        """Return what its cycles came to, by when they began and ended."""
        cycles_per_s = cycles / (ended - began)
        return Figures(
            cycles_per_s=cycles_per_s,
            startup_s=began - self.started,
            processor_ms=1e3 * self.busy(began, ended) / cycles_per_s,
            lost=lost,
        )

    def busy(self, began: float, ended: float) -> float:
        """Return the processor time of all its processes for each second of a time.

        The middle 60 % of that time is used: start-up and end do not count. User and system time
        of the program and all its descendants; NaN if the time was too short to tell.
        """
        edge = 0.2 * (ended - began)
        inside = [each for each in self.samples if began + edge <= each.at <= ended - edge]
        if len(inside) < 2:
            return nan
        first, last = inside[0], inside[-1]
        return (last.processor_s - first.processor_s) / (last.at - first.at)


def run(command: Sequence[str]) -> Watched:
    """Run a program to its end.

    It gets SIGTERM if this process ends before it, and is killed with its descendants if it takes
    too long.
    """
    with tempfile.NamedTemporaryFile("w", prefix="bench-") as output:
        started = time.monotonic()
        process = subprocess.Popen(
            ["setpriv", "--pdeathsig", "TERM", *command],
            stdout=output,
            stderr=subprocess.STDOUT,
            process_group=0,
        )
        samples: list[Sample] = []
        try:
            while process.poll() is None:
                if time.monotonic() > started + LIMIT_S:
                    raise SystemExit(f"{command[1:3]} took over {LIMIT_S:g} s")
                samples += _sample(process.pid)
                time.sleep(SAMPLE_S)
        finally:
            if process.poll() is None:
                _end(process)
        text = Path(output.name).read_text(encoding="utf-8")
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}\nended with status {process.returncode}:\n{text}")
    return Watched(text, started, samples)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(20.0)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _sample(pid: int) -> Iterable[Sample]:
    """Yield what the processes have used so far; nothing if one has just ended."""
    try:
        root = psutil.Process(pid)
        processes = [root, *root.children(recursive=True)]
        processor_s = sum(sum(process.cpu_times()[:2]) for process in processes)
    except psutil.Error:
        return
    yield Sample(time.monotonic(), processor_s)


class Launch(Figures, frozen=True, kw_only=True):
    """One launch; `own_mb` is the memory of the median direct controller, NaN in a short run."""

    own_mb: float


def launch(heliarch: Path, scenario: str, cycles: int, keep: Path | None = None) -> Launch:
    """Launch a scenario with cycles of one second in lockstep, recorded."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        summary = Path(folder) / "summary.json"
        out = str(keep or Path(folder) / "run")
        command = [str(heliarch), "launch", scenario, "--pace", "max", "--duration", f"{cycles}s"]
        watched = run([*command, "--out", out, "--json", str(summary)])
        return _read(msgspec.json.decode(summary.read_bytes()), watched)


def _read(summary: dict[str, Any], watched: Watched) -> Launch:
    """Take the figures out of a summary: the one place that knows its names."""
    direct_mb = [each["own_mb"] for each in summary["processes"] if each["kind"] == "direct"]
    began = watched.started + summary["startup_s"]
    ended = began + summary["wall_s"]
    seen = watched.figures(began, ended, summary["cycles"], summary["messages_lost"])
    return Launch(
        **msgspec.structs.asdict(seen),
        own_mb=statistics.median(direct_mb) or nan if direct_mb else nan,
    )


def run_script(script: str, *words: object) -> tuple[Figures, dict[str, Any]]:
    """Run a script of this folder that runs a graph; return what that came to, and what it says.

    It prints a line of JSON with the arguments of `Watched.figures`, and more.
    """
    watched = run([sys.executable, str(Path(__file__).with_name(script)), *map(str, words)])
    said: dict[str, Any] = msgspec.json.decode(watched.output.splitlines()[-1])
    names = {"began", "ended", "cycles", "lost"} & said.keys()
    return watched.figures(**{name: said[name] for name in names}), said
