"""Runs programs, `heliarch launch` above all, in alternating rounds; watches them from outside."""

from __future__ import annotations

import argparse
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from importlib.metadata import version
from math import isnan, nan
from pathlib import Path
from statistics import median
from typing import Any, Final

import msgspec
import psutil
from rich.console import Console

from results.tables import Column, Table, key_column, print_table

OURS: Final = Path(__file__).parents[1]
"""The checkout that is measured; others can be measured with its environment."""
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


def run(command: Sequence[str], checkout: Path = OURS) -> Watched:
    """Run a program to its end, with the code of a checkout.

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
            env={**os.environ, "PYTHONPATH": str(checkout.resolve())},
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


def launch(checkout: Path, scenario: str, cycles: int, keep: Path | None = None) -> Launch:
    """Launch a scenario in lockstep, recorded."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        summary = Path(folder) / "summary.json"
        out = str(keep or Path(folder) / "run")
        command = [sys.executable, "-P", "-m", "heliarch", "launch", scenario, "--pace", "max"]
        options = ["--duration", f"c{cycles}", "--out", out, "--json", str(summary)]
        watched = run([*command, *options], checkout)
        return _read(msgspec.json.decode(summary.read_bytes()), watched)


def _read(summary: dict[str, Any], watched: Watched) -> Launch:
    """Take the figures out of a summary: the one place that knows its names."""
    direct_mb = [each["own_mb"] for each in summary["processes"] if each["kind"] == "direct"]
    began = watched.started + summary["startup_s"]
    ended = began + summary["wall_s"]
    seen = watched.figures(began, ended, summary["cycles"], summary["messages_lost"])
    return Launch(
        **msgspec.structs.asdict(seen),
        own_mb=median(direct_mb) or nan if direct_mb else nan,
    )


def run_script(script: str, *words: object) -> tuple[Figures, dict[str, Any]]:
    """Run a script of this folder that runs a graph; return what that came to, and what it says.

    It prints a line of JSON with the arguments of `Watched.figures`, and more.
    """
    watched = run([sys.executable, str(Path(__file__).with_name(script)), *map(str, words)])
    said: dict[str, Any] = msgspec.json.decode(watched.output.splitlines()[-1])
    names = {"began", "ended", "cycles", "lost"} & said.keys()
    return watched.figures(**{name: said[name] for name in names}), said


# Rounds -------------------------------------------------------------------------------------------

COLUMNS: Final = (
    Column("cycles/s", "", 1, name="cycles_per_s"),
    Column("processor time", "ms a cycle", 1, name="processor_ms"),
    Column("start-up", "s", 2, name="startup_s"),
    Column("direct controller", "MB, its own", 1, name="own_mb"),
)
"""What each figure is called."""


def options(about: str | None, rounds: int, cycles: int) -> argparse.ArgumentParser:
    """Return the options that all benchmarks in rounds have."""
    parser = argparse.ArgumentParser(description=(about or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=rounds)
    parser.add_argument("--cycles", type=int, default=cycles, help="of a launch in lockstep")
    return parser


def measure(
    title: str, count: int, ways: Mapping[str, Callable[[], Figures]], shown: Collection[str]
) -> None:
    """Measure each way once in each round, and print some figures; each round begins elsewhere.

    Other work on the machine comes and goes: it meets all ways, and ratios of one round hold where
    the figures themselves do not. Ends the program if messages got lost.
    """
    found: dict[str, list[Figures]] = {name: [] for name in ways}
    in_turn = deque(ways)
    for number in range(count):
        sys.stderr.write(f"round {number + 1} of {count}, load {psutil.getloadavg()[0]:.1f}\n")
        for name in in_turn:
            found[name].append(ways[name]())
        in_turn.rotate()
    columns = [column for column in COLUMNS if column.name in shown]
    _print_rounds(f"{title}, {count} rounds", found, columns)
    if lost := sum(each.lost for runs in found.values() for each in runs):
        raise SystemExit(f"{lost:,} messages lost")


def _print_rounds(
    title: str, found: Mapping[str, Sequence[Figures]], columns: Sequence[Column]
) -> None:
    """Print the figures of each way, and its rate beside that of the first, round by round."""
    first, *_ = found.values()
    rows = []
    for name, runs in found.items():
        cells = [
            _spread((getattr(one, column.name, nan) for one in runs), column.decimals)
            for column in columns
        ]
        pairs = zip(first, runs, strict=True)
        ratios = [base.cycles_per_s / one.cycles_per_s for base, one in pairs]
        rows.append((name, *cells, "" if runs is first else _spread(ratios, 2)))
    ratio = Column(f"{next(iter(found))}: times as many cycles/s")
    machine = (
        f"{platform.system()} {platform.release()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, Zenoh {version('eclipse-zenoh')}"
    )
    notes = ("median (least, most) of all rounds; times as many: round by round", machine)
    print_table(Console(width=100), Table(title, [key_column("way"), *columns, ratio], rows, notes))


def _spread(values: Iterable[float], decimals: int) -> str:
    known = [value for value in values if not isnan(value)]
    if not known:
        return "-"
    middle, least, most = (f"{of(known):,.{decimals}f}" for of in (median, min, max))
    return f"{middle} ({least}, {most})"
