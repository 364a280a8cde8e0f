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
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Final

import msgspec
import peer_graph
from harness import OURS, Failure, launch, print_table, rounds_of, run, write_figures

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
    cycles_per_s = cycles / (ended - began)
    processor_ms = 1e3 * watched.busy(began, ended) / cycles_per_s
    return Figures(cycles_per_s, processor_ms, watched.processes)


def heliarch(cycles: int) -> Figures:
    """Launch the plant with Heliarch, recorded."""
    result = launch(OURS, "oahu", cycles)
    if result.lost:
        raise Failure(f"heliarch launch: {result.lost:,} messages lost")
    return Figures(result.cycles_per_s, result.processor_ms, result.processes)


def rows_of(rounds: dict[str, list[Figures]]) -> Iterator[tuple[str, ...]]:
    for name, figures in rounds.items():
        rates = [each.cycles_per_s for each in figures]
        pairs = zip(rounds["Heliarch"], figures, strict=True)
        ratio = median(ours.cycles_per_s / each.cycles_per_s for ours, each in pairs)
        yield (
            name,
            *(f"{value:,.1f}" for value in (median(rates), min(rates), max(rates))),
            f"{median(each.processor_ms for each in figures):.1f} ms",
            str(max(each.processes for each in figures)),
            "" if name == "Heliarch" else f"{ratio:.1f} times",
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cycles", type=int, default=300)
    parser.add_argument("--core", default="ipc", help="HELICS core: ipc, zmq, zmq_ss, tcp, tcp_ss")
    parser.add_argument("--json", type=Path, metavar="PATH", help="write all figures as JSON")
    options = parser.parse_args()
    cycles, core = options.cycles, options.core
    helics = f"HELICS {version('helics')} ({core}), not recorded"
    mosaik = f"mosaik {version('mosaik')}, not recorded"
    rounds: dict[str, list[Figures]] = {helics: [], mosaik: [], "Heliarch": []}
    try:
        for _ in rounds_of(options.rounds):
            rounds[helics].append(peer("peer_helics.py", cycles, core))
            rounds[mosaik].append(peer("peer_mosaik.py", cycles))
            rounds["Heliarch"].append(heliarch(cycles))
    except Failure as failure:
        sys.stderr.write(f"peers: {failure}\n")
        return 1
    title = f"22 nodes, 6 hops in a cycle: {options.rounds} rounds, {cycles:,} cycles each"
    rates = (f"{which}\ncycles/s" for which in ("median", "min", "max"))
    others = ("processor time\nin a cycle", "processes", "Heliarch is faster,\nround by round")
    print_table(title, ("", *rates, *others), rows_of(rounds))
    write_figures(rounds, options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
