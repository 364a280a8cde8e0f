"""What the live page costs a launched plant: without it, with it, and with browsers that look on.

    python benchmarks/page_cost.py --rounds 3

Each round launches the plant in lockstep and then in real time, once for each case. A browser is
stood for by a client that takes every update, in a process of its own, behind all others, and draws
nothing: a real one is usually another machine's load.
"""

from __future__ import annotations

import argparse
import os
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import defaultdict, deque
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import msgspec
import psutil
from rich.console import Console
from rich.table import Table

from studies.timing.report import report_on

CASES: Final = {
    "no page": None,
    "page, no browser": 0,
    "page, 1 browser": 1,
    "page, 5 browsers": 5,
}


class Cost(msgspec.Struct, frozen=True):
    """One launch. `page_ms` is the page's processor time for each second of the run [ms]."""

    cycles_per_s: float
    loop_p99_ms: float | None
    missed_inputs: int
    page_ms: float
    page_mb: float


def measure(browsers: int | None, scenario: str, pace: str, seconds: int) -> Cost:
    """Launch the plant, with so many browsers; None: without the page."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        run, output = Path(folder) / "run", Path(folder) / "output"
        command = [sys.executable, "-m", "launch_scripts", "launch", scenario, "--pace", pace]
        command += ["--duration", f"{seconds}s", "--out", str(run)]
        with output.open("w", encoding="utf-8") as out:
            launched = subprocess.Popen(
                [*command, *(() if browsers is None else ("--page",))],
                stdout=out,
                stderr=subprocess.STDOUT,
            )
        reader: subprocess.Popen[bytes] | None = None
        began_s, page_s, page_mb = None, 0.0, 0.0
        while launched.poll() is None:
            text = output.read_text(encoding="utf-8")
            if browsers and reader is None and (found := re.search(r"page: (http\S+)", text)):
                words = ["--read", f"{found[1]}stream", str(browsers)]
                reader = subprocess.Popen([sys.executable, __file__, *words])
            if reader is not None and "recording: " in text:
                reader.kill()
            with suppress(psutil.Error):
                for child in psutil.Process(launched.pid).children():
                    if "live_page" in child.cmdline():
                        page_s = sum(child.cpu_times()[:2])
                        if began_s is None and "armed: " in text:
                            began_s = page_s
                        page_mb = child.memory_info().rss / 1e6
            time.sleep(0.2)
        if reader is not None:
            reader.wait()
        if launched.returncode:
            raise SystemExit(output.read_text(encoding="utf-8"))
        summary: dict[str, Any] = msgspec.json.decode((run / "summary.json").read_bytes())
        return Cost(
            summary["cycles_per_s"],
            None if pace == "max" else loop_p99_ms(run),
            summary["missing_inputs"],
            1e3 * (page_s - (began_s or 0.0)) / summary["wall_s"],
            page_mb,
        )


def loop_p99_ms(run: Path) -> float:
    """Return the 99th percentile of the loop times of a real-time run."""
    loops = sorted(report_on(run).timing.loop_ns)
    return float(loops[len(loops) * 99 // 100]) / 1e6


def read(address: str, browsers: int) -> None:
    """Take all updates, as so many browsers do."""
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))

    def follow() -> None:
        with urllib.request.urlopen(address) as updates:
            for _ in updates:
                pass

    for _ in range(browsers):
        threading.Thread(target=follow).start()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="oahu")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cycles", type=int, default=1500)
    parser.add_argument("--pace", default="20", help="of the launches in real time")
    parser.add_argument("--read", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read:
        read(options.read[0], int(options.read[1]))
        return
    costs: dict[tuple[str, str], list[Cost]] = defaultdict(list)
    cases = deque(CASES.items())
    for _ in range(options.rounds):
        cases.rotate()  # Other work on the machine comes and goes.
        for pace in ("max", options.pace):
            cycles = options.cycles if pace == "max" else options.cycles // 4
            for case, browsers in cases:
                cost = measure(browsers, options.scenario, pace, cycles)
                load = psutil.getloadavg()[0]
                sys.stderr.write(f"{case}, pace {pace}, load {load:.1f}: {cost}\n")
                costs[case, pace].append(cost)
    table = Table(title=f"{options.scenario}: median of {options.rounds} rounds")
    table.add_column("")
    for heading in (
        "lockstep, cycles/s",
        f"pace {options.pace}, loop p99 [ms]",
        "inputs missed",
        "page, lockstep [ms/s]",
        f"page, pace {options.pace} [ms/s]",
        "page [MB]",
    ):
        table.add_column(heading, justify="right")
    for case in CASES:
        lockstep, real = costs[case, "max"], costs[case, options.pace]
        table.add_row(
            case,
            *(
                f"{statistics.median(values):,.1f}"
                for values in (
                    [cost.cycles_per_s for cost in lockstep],
                    [cost.loop_p99_ms or 0.0 for cost in real],
                    [cost.missed_inputs for cost in real],
                    [cost.page_ms for cost in lockstep],
                    [cost.page_ms for cost in real],
                    [cost.page_mb for cost in [*lockstep, *real]],
                )
            ),
        )
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
