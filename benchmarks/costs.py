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
from collections import deque
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import NamedTuple

import msgspec
from harness import OURS, die_with_parent, launch, print_table, rounds_of, run


class Way(NamedTuple):
    """A way to launch the plant, and how many browsers look on."""

    name: str
    program: Path
    words: tuple[str, ...] = ()
    browsers: int = 0


class Cost(NamedTuple):
    """What a way has cost in one round, in lockstep and in real time."""

    cycles_per_s: float
    processor_ms: float
    startup_s: float
    loop_p50_ms: float
    loop_p99_ms: float
    missed_inputs: float
    page_ms: float
    page_real_ms: float
    page_mb: float


HEADINGS = (
    *("", "cycles/s", "ms per\ncycle", "start-up\n[s]", "loop p50\n[ms]", "loop p99\n[ms]"),
    *("inputs\nmissed", "page in\nlockstep\n[ms/s]", "page in\nreal time\n[ms/s]", "page\n[MB]"),
)


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
    return Cost(
        *(fast.cycles_per_s, fast.processor_ms, fast.startup_s),
        *(loop["p50_us"] / 1e3, loop["p99_us"] / 1e3, real.missed_inputs),
        *(fast.page_ms, real.page_ms, max(fast.page_mb, real.page_mb)),
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
        costs: dict[str, list[Cost]] = {way.name: [] for way in ways}
        in_turn = deque(ways)
        for _ in rounds_of(options.rounds):
            in_turn.rotate()  # Other work on the machine comes and goes.
            for way in in_turn:
                settings = (options.scenario, options.cycles, options.rate, options.seconds)
                costs[way.name].append(measure(way, *settings))
    rows = [
        (name, *(f"{median(values):,.1f}" for values in zip(*found, strict=True)))
        for name, found in costs.items()
    ]
    print_table(f"{options.scenario}: medians of {options.rounds} rounds", HEADINGS, rows)
    first, *others = costs.items()
    for name, found in others:
        pairs = zip(found, first[1], strict=True)
        ratios = [one.cycles_per_s / base.cycles_per_s for one, base in pairs]
        print(
            f"cycles/s, {name} / {first[0]}, round by round: {min(ratios):.2f} to {max(ratios):.2f}"
        )


if __name__ == "__main__":
    main()
