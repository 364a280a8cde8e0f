"""What encrypted links cost: `heliarch launch` with and without `--secure`, in alternating rounds.

    python benchmarks/secure_cost.py --rounds 5 --before ../before/.venv/bin/heliarch

Each round launches the plant once in lockstep (cycles/s, processor time) and once in real time (the
loop from tick to last command, of all commands), first without keys, then with. `--before` is the
program of another checkout, measured in the same rounds.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import msgspec
from launched import launch
from outside import run
from rich.console import Console
from rich.table import Table


class Figures(NamedTuple):
    """Of one round and one way to link."""

    cycles_per_s: float
    processor_ms: float
    startup_s: float
    loop_p50_ms: float
    loop_p99_ms: float


def measure(program: Path, words: list[str], options: argparse.Namespace) -> Figures:
    """Launch the plant in lockstep and in real time."""
    fast = launch(program, options.scenario, options.cycles, words=words)
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        out, figures = Path(folder) / "run", Path(folder) / "timing.json"
        pace = ["--pace", str(options.rate), "--duration", str(options.seconds * options.rate)]
        run([str(program), "launch", options.scenario, *pace, *words, "--out", str(out)])
        # Its exit status says whether budgets are met, which does not matter here.
        judge = [str(program), "timing", str(out), "--json", str(figures)]
        subprocess.run(judge, stdout=subprocess.DEVNULL, check=False)
        (loop,) = (
            each["times"]
            for each in msgspec.json.decode(figures.read_bytes())["times"]
            if (each["measure"], each["of"]) == ("loop", "all commands")
        )
    p50_ms, p99_ms = loop["p50_us"] / 1e3, loop["p99_us"] / 1e3
    return Figures(fast.cycles_per_s, fast.processor_ms, fast.startup_s, p50_ms, p99_ms)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="oahu")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cycles", type=int, default=600, help="of a launch in lockstep")
    parser.add_argument("--rate", type=int, default=5, help="cycles per second in real time")
    parser.add_argument("--seconds", type=int, default=20, help="of a launch in real time")
    parser.add_argument("--before", type=Path, help="program of another checkout")
    parser.add_argument("--program", type=Path, default=Path(sys.executable).parent / "heliarch")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench-keys-") as keys:
        run([str(options.program), "keys", options.scenario, "--out", keys])
        ways = {
            **({"before": (options.before, [])} if options.before else {}),
            "without keys": (options.program, []),
            "with keys": (options.program, ["--secure", "--keys", keys]),
        }
        found: dict[str, list[Figures]] = {way: [] for way in ways}
        for number in range(options.rounds):
            for way, (program, words) in ways.items():
                sys.stderr.write(f"round {number + 1}, {way}\n")
                found[way].append(measure(program, words, options))
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    table = Table(title=f"{options.scenario}: medians of {options.rounds} rounds, load {load}")
    for heading in ("", "cycles/s", "ms a cycle", "start-up, s", "loop p50, ms", "loop p99, ms"):
        table.add_column(heading, justify="right" if heading else "left")
    for way, rounds in found.items():
        table.add_row(
            way, *(f"{statistics.median(values):,.1f}" for values in zip(*rounds, strict=True))
        )
    ratios = [
        secure.cycles_per_s / bare.cycles_per_s
        for secure, bare in zip(found["with keys"], found["without keys"], strict=True)
    ]
    Console(width=100).print(table)
    sys.stdout.write(
        f"cycles/s with keys / without, round by round: {min(ratios):.2f} to {max(ratios):.2f}\n"
    )


if __name__ == "__main__":
    main()
