"""The same control graph with Heliarch, HELICS and mosaik. What `make bench-peers` runs.

    python benchmarks/peers.py --rounds 5 --cycles 300

HELICS (`peer_helics.py`) and mosaik (`peer_mosaik.py`) run the graph of `peer_graph.py`: 22 nodes,
each a process, six serial hops in a cycle, the paper's rule on one number for each message, no
recording. Heliarch is `heliarch launch oahu --pace max`: its own 22 agents in the same tree, with a
header on each message, all inputs checked, and everything recorded.

Power delivered by the two peers is compared with a calculation in one process, cycle by cycle: a
loop in the wrong order ends the benchmark with status 1. Processor time is that of all processes,
HELICS's broker, mosaik's scheduler, Heliarch's launcher and recorder included, while cycles run.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Final

import peer_graph
from harness import OURS, Failure, Figures, launch, run_script
from rounds import measured, print_rounds, write_figures

TOLERANCE_KW: Final = 1e-6
COLUMNS: Final = {
    "cycles_per_s": ("cycles/s", "", 1),
    "processor_ms": ("processor time", "ms a cycle", 1),
    "processes": ("processes", "", 0),
}


def peer(script: str, cycles: int, *options: str) -> Figures:
    """Run the graph with a peer and check what it delivered."""
    figures, said = run_script(script, cycles, *options)
    expected = peer_graph.expected_kw(cycles)
    for cycle, (got, want) in enumerate(zip(said["delivered_kw"], expected, strict=True)):
        if abs(got - want) > TOLERANCE_KW:
            raise Failure(f"{script}: cycle {cycle} delivered {got:.3f} kW, expected {want:.3f}")
    return figures


def heliarch(cycles: int) -> Figures:
    """Launch the plant with Heliarch, recorded."""
    result = launch(OURS, "oahu", cycles)
    if result.lost:
        raise Failure(f"heliarch launch: {result.lost:,} messages lost")
    return result


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
    ways = {
        "Heliarch": partial(heliarch, cycles),
        helics: partial(peer, "peer_helics.py", cycles, core),
        mosaik: partial(peer, "peer_mosaik.py", cycles),
    }
    try:
        found = measured(options.rounds, ways)
    except Failure as failure:
        sys.stderr.write(f"peers: {failure}\n")
        return 1
    title = f"22 nodes, 6 hops in a cycle: {options.rounds} rounds, {cycles:,} cycles each"
    print_rounds(title, found, COLUMNS)
    write_figures(found, options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
