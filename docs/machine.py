"""Takes the figures that depend on the machine: `make figures`, half an hour.

Run it on a quiet machine. Each figure is a row of `docs/tables/figures.csv`, with its unit, the
command that gave it and the date; pages show it by its name (see `shown.py`). A figure that this
program does not take keeps its row.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from docs.shown import Found, keep

REPOSITORY: Final = Path(__file__).parents[1]
BIN: Final = Path(sys.executable).parent


class Done(NamedTuple):
    """What a command wrote as JSON, or else printed, and what it used of the machine."""

    said: Any
    processor_s: float
    largest_mb: float


def timing(rate: int, done: Done) -> Found:
    """Yield what a run in real time came to; `loop` is p50, p99 and the largest."""
    (loop,) = (row for row in done.said["times"] if row["of"] == "all commands")
    times = (f"{loop[name]:.1f}" for name in ("p50_ms", "p99_ms", "max_ms"))
    yield f"loop at {rate}", " / ".join(times), "ms"
    for name in ("cycles", "late_cycles", "lost_messages"):
        yield f"{name} at {rate}", str(done.said["run"][name]), ""
    for name in ("missed_deadlines", "overruns"):
        yield f"{name} at {rate}", str(sum(tier[name] or 0 for tier in done.said["tiers"])), ""


def fastest(done: Done) -> Found:
    for name, field in (("clean rate", "highest_clean_hz"), ("too fast", "too_fast_hz")):
        rate = done.said[field]
        yield name, "-" if rate is None else f"{rate:.0f}", "cycles/s"


def launched(name: str, done: Done) -> Found:
    yield f"{name} rate", f"{done.said['cycles'] / done.said['wall_s']:.2g}", "cycles/s"
    yield f"{name} start", f"{done.said['startup_s']:.1f}", "s"
    yield f"{name} messages", str(sum(each["recorded"] for each in done.said["messages"])), ""
    yield f"{name} lost", str(done.said["messages_lost"]), ""
    yield f"{name} missed", str(done.said["missing_inputs"]), ""
    busy_s = sum(each["cpu_s"] for each in done.said["processes"])
    yield f"{name} processor", f"{1e3 * busy_s / done.said['cycles']:.0f}", "ms a cycle"
    for kind in ("plant", "recorder"):
        (memory,) = (each["resident_mb"] for each in done.said["processes"] if each["kind"] == kind)
        yield f"{name} {kind}", f"{memory:.0f}", "MB"


def used(name: str, done: Done) -> Found:
    yield f"{name} time", f"{float(f'{done.processor_s:.2g}'):g}", "s of processor time"
    yield f"{name} memory", f"{done.largest_mb:.0f}", "MB"


def benchmark(done: Done) -> Found:
    """Yield the median rate of each way that a benchmark prints in a line."""
    awaited = {"launch", "bare", "Heliarch", "mosaik"}
    for line in done.said.splitlines():
        way, _, rest = line.strip().partition("  ")
        name = way.split(" ")[0]
        if rest and name in awaited:  # What does not fit beside comes in a second table.
            awaited.remove(name)
            yield f"{name} rate", rest.split()[0], "cycles/s"


COMMANDS: Final[dict[str, Callable[[Done], Found] | None]] = {
    **{
        f"heliarch timing oahu --rate {rate} --duration 2m --priority 20": partial(timing, rate)
        for rate in (1, 20, 50)
    },
    "heliarch timing oahu --rate 20..320 --duration 10s --priority 20": fastest,
    "heliarch launch thousand --duration 10m": partial(launched, "thousand"),
    "heliarch launch ten-thousand --duration 10m": partial(launched, "ten-thousand"),
    "heliarch launch ten-thousand --pace 10 --priority 20 --duration 100m": partial(
        launched, "ten-thousand real time"
    ),
    "heliarch simulate oahu-day --duration 5h --out RUN": None,
    "heliarch inspect RUN": partial(used, "inspect"),
    "heliarch inspect RUN --nodes c1/inv01": partial(used, "inspect node"),
    "heliarch export RUN --format json-mcap": partial(used, "json-mcap"),
    "heliarch export RUN --format parquet": partial(used, "parquet"),
    "heliarch simulate oahu-day --out RUN/day": None,
    "heliarch report RUN/day": partial(used, "report day"),
    "heliarch compare oahu-day --days 2010-06-01..2010-06-24 --workers 2 --schemes "
    "uncontrolled,uniform-cap,paper,predictive,physical-limit": partial(used, "study"),
    "python benchmarks/cycle_rate.py": benchmark,
    ".venv-peers/bin/python benchmarks/peers.py": benchmark,
}
"""What is taken from each command. RUN stands for one folder."""


def run(command: str, folder: Path) -> Done:
    program, script, *words = command.replace("RUN", str(folder / "RUN")).split()
    found = folder / "found.json"
    found.unlink(missing_ok=True)
    if program == "heliarch" and script != "report":
        words += ["--json", str(found)]
    else:
        script = str(REPOSITORY / script)
    with (folder / "output").open("w+", encoding="utf-8") as output:
        path = REPOSITORY / program if "/" in program else BIN / program
        process = subprocess.Popen([path, script, *words], stdout=output, cwd=folder)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        printed = output.read()
    if process.returncode not in {0, 1}:  # 1: a budget was not kept.
        raise SystemExit(f"{command}: exit status {process.returncode}")
    seconds, largest_mb = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024
    return Done(json.loads(found.read_text()) if found.exists() else printed, seconds, largest_mb)


def main() -> None:
    """Run all commands, or those whose text holds a word that is given."""
    words = sys.argv[1:] or [""]
    with tempfile.TemporaryDirectory(prefix="figures-") as folder:
        for command, figures in COMMANDS.items():
            if any(word in command for word in words):
                began = time.monotonic()
                done = run(command, Path(folder))
                if figures:
                    keep(command, figures(done))
                print(f"{command}: {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
