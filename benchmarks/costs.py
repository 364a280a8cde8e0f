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

import os
import re
import subprocess
import tempfile
import threading
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
from harness import OURS, Figures, Launch, die_with_parent, launch, run
from rounds import measure, options

SHOWN: Final = (
    *("cycles_per_s", "processor_ms", "startup_s", "loop_p50_ms", "loop_p99_ms"),
    *("missed_inputs", "page_ms", "page_real_ms"),
)


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


def browsers(count: int) -> Callable[[str], None]:
    """Return what opens the page of a run in some browsers, as soon as its address is printed."""
    opened: list[str] = []

    def look(output: str) -> None:
        if count and not opened and (page := re.search(r"page: (\S+)", output)):
            opened.append(page[1])
            # This process runs one thread, so it may fork.
            get_context("fork").Process(target=read, args=(page[1], count), daemon=True).start()

    return look


def read(page: str, count: int) -> None:
    """Take all updates until the run is over, as so many browsers do."""
    die_with_parent()
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))

    def follow() -> None:
        # A short run may be over, and its page gone, before a browser is there.
        with suppress(ConnectionError), urllib.request.urlopen(f"{page}stream") as updates:
            for update in updates:
                if b'"state":"over"' in update:
                    return

    for _ in range(count):
        threading.Thread(target=follow).start()


def cost(way: Way, scenario: str, cycles: int, rate: int, seconds: int) -> Cost:
    """Launch the plant in lockstep and in real time."""
    fast = launch(way.program, scenario, cycles, *way.words, look=browsers(way.browsers))
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        out, timing = Path(folder) / "run", Path(folder) / "timing.json"
        real = launch(
            way.program,
            scenario,
            seconds * rate,
            *way.words,
            pace=str(rate),
            keep=out,
            look=browsers(way.browsers),
        )
        # Its exit status says whether budgets are met, which does not matter here.
        judge = [str(way.program), "timing", str(out), "--json", str(timing)]
        subprocess.run(judge, stdout=subprocess.DEVNULL, check=False)
        (loop,) = (
            each["times"]
            for each in msgspec.json.decode(timing.read_bytes())["times"]
            if (each["measure"], each["of"]) == ("loop", "all commands")
        )
    return Cost(
        **msgspec.structs.asdict(fast) | {"missed_inputs": real.missed_inputs},
        loop_p50_ms=loop["p50_us"] / 1e3,
        loop_p99_ms=loop["p99_us"] / 1e3,
        page_real_ms=real.page_ms,
    )


def main() -> None:
    parser = options(__doc__, rounds=5, cycles=600)
    parser.add_argument("what", choices=("page", "keys"))
    parser.add_argument("--scenario", default="oahu")
    parser.add_argument("--rate", type=int, default=5, help="cycles per second in real time")
    parser.add_argument("--seconds", type=int, default=20, help="of a launch in real time")
    parser.add_argument("--before", type=Path, help="program of another checkout")
    words = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench-keys-") as keys:
        ways = [Way("before", words.before)] if words.before else []
        if words.what == "page":
            ways += [Way("no page", OURS), Way("page, no browser", OURS, ("--page",))]
            ways += [Way(f"page, browsers: {count}", OURS, ("--page",), count) for count in (1, 5)]
        else:
            run([str(OURS), "keys", words.scenario, "--out", keys])
            ways += [Way("without keys", OURS)]
            ways += [Way("with keys", OURS, ("--secure", "--keys", keys))]
        settings = (words.scenario, words.cycles, words.rate, words.seconds)
        costs: dict[str, Callable[[], Figures]] = {
            way.name: partial(cost, way, *settings) for way in ways
        }
        measure(words.scenario, words.rounds, costs, SHOWN)


if __name__ == "__main__":
    main()
