"""What the live page, and what encrypted links cost a launched plant, in alternating rounds.

    python benchmarks/costs.py page --rounds 3 --cycles 600
    python benchmarks/costs.py keys --rounds 5 --before ../before/.venv/bin/heliarch

Each round launches the plant in each way in lockstep (cycles/s, processor time), and then in real
time (the loop from tick to last command, of all commands). `--before` is the program of another
checkout, measured in the same rounds. A browser is stood for by a client that takes every update,
in a process of its own, behind all others, and draws nothing: a real one is usually another
machine's load.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import threading
import urllib.request
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
from harness import OURS, Launch, die_with_parent, launch, run
from rounds import measured, print_rounds


class Way(NamedTuple):
    """A way to launch the plant, and how many browsers look on."""

    name: str
    program: Path
    words: tuple[str, ...] = ()
    browsers: int = 0


class Cost(Launch, frozen=True, kw_only=True):
    """A launch in lockstep, and what one in real time has shown: loop, page and missed inputs."""

    loop_p50_ms: float
    loop_p99_ms: float
    page_real_ms: float


COLUMNS: Final = {
    "cycles_per_s": ("cycles/s", "", 1),
    "processor_ms": ("processor time", "ms a cycle", 1),
    "startup_s": ("start-up", "s", 1),
    "loop_p50_ms": ("loop p50", "ms", 1),
    "loop_p99_ms": ("loop p99", "ms", 1),
    "missed_inputs": ("missed inputs", "", 0),
    "page_ms": ("page, lockstep", "ms/s", 1),
    "page_real_ms": ("page, real time", "ms/s", 1),
    "page_mb": ("page", "MB", 1),
}


class Browsers:
    """Browsers that open the page of a run as soon as its address is printed."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._process: subprocess.Popen[bytes] | None = None

    def look(self, output: str) -> None:
        if self._count and self._process is None and (page := re.search(r"page: (\S+)", output)):
            words = ["--read", f"{page[1]}stream", str(self._count)]
            self._process = subprocess.Popen([sys.executable, __file__, "page", *words])


def read(address: str, browsers: int) -> None:
    """Take all updates until the run is over, as so many browsers do."""
    die_with_parent()
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))

    def follow() -> None:
        # A short run may be over, and its page gone, before a browser is there.
        with suppress(ConnectionError), urllib.request.urlopen(address) as updates:
            for update in updates:
                if b'"state":"over"' in update:
                    return

    for _ in range(browsers):
        threading.Thread(target=follow).start()


def measure(way: Way, scenario: str, cycles: int, rate: int, seconds: int) -> Cost:
    """Launch the plant in lockstep and in real time."""
    fast = launch(way.program, scenario, cycles, *way.words, look=Browsers(way.browsers).look)
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        out, figures = Path(folder) / "run", Path(folder) / "timing.json"
        browsers = Browsers(way.browsers)
        cycles, pace = seconds * rate, str(rate)
        real = launch(
            way.program, scenario, cycles, *way.words, pace=pace, keep=out, look=browsers.look
        )
        # Its exit status says whether budgets are met, which does not matter here.
        judge = [str(way.program), "timing", str(out), "--json", str(figures)]
        subprocess.run(judge, stdout=subprocess.DEVNULL, check=False)
        (loop,) = (
            each["times"]
            for each in msgspec.json.decode(figures.read_bytes())["times"]
            if (each["measure"], each["of"]) == ("loop", "all commands")
        )
    of_real = {"missed_inputs": real.missed_inputs, "page_mb": max(fast.page_mb, real.page_mb)}
    return Cost(
        **msgspec.structs.asdict(fast) | of_real,
        loop_p50_ms=loop["p50_us"] / 1e3,
        loop_p99_ms=loop["p99_us"] / 1e3,
        page_real_ms=real.page_ms,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("page", "keys"))
    parser.add_argument("--scenario", default="oahu")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cycles", type=int, default=600, help="of a launch in lockstep")
    parser.add_argument("--rate", type=int, default=5, help="cycles per second in real time")
    parser.add_argument("--seconds", type=int, default=20, help="of a launch in real time")
    parser.add_argument("--before", type=Path, help="program of another checkout")
    parser.add_argument("--read", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read:
        read(options.read[0], int(options.read[1]))
        return
    with tempfile.TemporaryDirectory(prefix="bench-keys-") as keys:
        ways = [Way("before", options.before)] if options.before else []
        if options.what == "page":
            ways += [Way("no page", OURS), Way("page, no browser", OURS, ("--page",))]
            ways += [Way(f"page, browsers: {count}", OURS, ("--page",), count) for count in (1, 5)]
        else:
            run([str(OURS), "keys", options.scenario, "--out", keys])
            ways += [Way("without keys", OURS)]
            ways += [Way("with keys", OURS, ("--secure", "--keys", keys))]
        settings = (options.scenario, options.cycles, options.rate, options.seconds)
        costs = measured(
            options.rounds, {way.name: partial(measure, way, *settings) for way in ways}
        )
    print_rounds(f"{options.scenario}: {options.rounds} rounds", costs, COLUMNS)


if __name__ == "__main__":
    main()
