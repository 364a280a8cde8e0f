"""The same control graph with Heliarch, HELICS and mosaik. What `make bench-peers` runs.

    python benchmarks/peers.py --rounds 5 --cycles 300

Each round runs the three in turn, so what else the machine does meets all of them. HELICS
(`peer_helics.py`) and mosaik (`peer_mosaik.py`) run the graph of `peer_graph.py`: 22 nodes, each a
process, six serial hops in a cycle, the paper's rule on one number for each message, no recording.
Heliarch is `heliarch launch oahu --pace max`: its own 22 agents in the same tree, with a header on
each message, all inputs checked, and everything recorded.

Power delivered by the two peers is compared with a calculation in one process, cycle by cycle: a
loop in the wrong order ends the benchmark with status 1. Processor time is that of all processes,
HELICS's broker, mosaik's scheduler, Heliarch's launcher and recorder included, while cycles run.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec
import peer_graph
from launched import launch
from outside import Failure, run
from rich.console import Console
from rich.table import Table

HERE: Final = Path(__file__).parent
TOLERANCE_KW: Final = 1e-6


class Figures(msgspec.Struct, frozen=True):
    """What one run of one of the three came to."""

    cycles_per_s: float
    processor_ms: float
    processes: int


def peer(script: str, cycles: int, *options: str) -> Figures:
    """Run the graph with a peer and check what it delivered."""
    watched = run([sys.executable, str(HERE / script), str(cycles), *options])
    result = json.loads(watched.output.splitlines()[-1])
    expected = peer_graph.expected_kw(cycles)
    for cycle, (got, want) in enumerate(zip(result["delivered_kw"], expected, strict=True)):
        if abs(got - want) > TOLERANCE_KW:
            raise Failure(f"{script}: cycle {cycle} delivered {got:.3f} kW, expected {want:.3f}")
    began, ended = result["began"], result["ended"]
    processor_ms = watched.processor_ms(began, ended, cycles)
    return Figures(cycles / (ended - began), processor_ms, watched.processes)


def heliarch(cycles: int) -> Figures:
    """Launch the plant with Heliarch, recorded."""
    result = launch(Path(sys.executable).parent / "heliarch", "oahu", cycles)
    if result.lost:
        raise Failure(f"heliarch launch: {result.lost:,} messages lost")
    return Figures(result.cycles_per_s, result.processor_ms, result.processes)


def print_table(rounds: dict[str, list[Figures]], cycles: int, console: Console) -> None:
    """Print one row for each of the three."""
    count = len(rounds["Heliarch"])
    table = Table(title=f"22 nodes, 6 hops in a cycle: {count} rounds, {cycles:,} cycles each")
    table.add_column("", no_wrap=True)
    for heading in ("median", "min", "max"):
        table.add_column(f"{heading}\ncycles/s", justify="right")
    table.add_column("processor time\nin a cycle", justify="right")
    table.add_column("processes", justify="right")
    table.add_column("Heliarch is faster,\nround by round", justify="right")
    for name, figures in rounds.items():
        rates = [each.cycles_per_s for each in figures]
        processor_ms = statistics.median(each.processor_ms for each in figures)
        ratio = statistics.median(
            ours.cycles_per_s / each.cycles_per_s
            for ours, each in zip(rounds["Heliarch"], figures, strict=True)
        )
        table.add_row(
            name,
            *(f"{value:,.1f}" for value in (statistics.median(rates), min(rates), max(rates))),
            f"{processor_ms:.1f} ms",
            str(max(each.processes for each in figures)),
            "" if name == "Heliarch" else f"{ratio:.1f} times",
        )
    console.print(table)


def main() -> int:
    """Measure, print, write. Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cycles", type=int, default=300)
    parser.add_argument("--core", default="ipc", help="HELICS core: ipc, zmq, zmq_ss, tcp, tcp_ss")
    parser.add_argument("--json", type=Path, metavar="PATH", help="write all figures as JSON")
    options = parser.parse_args()
    console = Console(width=110)
    helics = f"HELICS {version('helics')} ({options.core}), not recorded"
    mosaik = f"mosaik {version('mosaik')}, not recorded"
    rounds: dict[str, list[Figures]] = {helics: [], mosaik: [], "Heliarch": []}
    try:
        for number in range(options.rounds):
            sys.stderr.write(f"round {number + 1} of {options.rounds}\n")
            rounds[helics].append(peer("peer_helics.py", options.cycles, options.core))
            rounds[mosaik].append(peer("peer_mosaik.py", options.cycles))
            rounds["Heliarch"].append(heliarch(options.cycles))
    except Failure as failure:
        sys.stderr.write(f"peers: {failure}\n")
        return 1
    print_table(rounds, options.cycles, console)
    console.print(
        f"Heliarch recorded. {platform.system()} {platform.release()}, "
        f"Python {platform.python_version()}",
        highlight=False,
    )
    if options.json is not None:
        options.json.write_bytes(msgspec.json.format(msgspec.json.encode(rounds), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
