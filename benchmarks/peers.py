"""The same control graph with Heliarch and mosaik. What `make bench-peers` runs.

    python benchmarks/peers.py --rounds 5 --cycles 300

Mosaik (`peer_mosaik.py`) runs the graph of `peer_graph.py`: 22 nodes, each a process, six serial
hops in a cycle, the paper's rule on one number for each message, no recording. Heliarch is
`heliarch launch oahu --pace max`: its own 22 agents in the same tree, with a header on each
message, all inputs checked, and everything recorded.

Power delivered is compared with a calculation in one process, cycle by cycle: a loop in the wrong
order ends the benchmark with status 1. Processor time is that of all processes, mosaik's scheduler
and Heliarch's launcher and recorder included, while cycles run.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from typing import Final

import peer_graph
from harness import OURS, Figures, launch, measure, options, run_script

TOLERANCE_KW: Final = 1e-6


def peer(script: str, cycles: int) -> Figures:
    """Run the graph with a peer and check what it delivered."""
    figures, said = run_script(script, cycles)
    expected = peer_graph.expected_kw(cycles)
    for cycle, (got, want) in enumerate(zip(said["delivered_kw"], expected, strict=True)):
        if abs(got - want) > TOLERANCE_KW:
            raise SystemExit(f"{script}: cycle {cycle} delivered {got:.3f} kW, expected {want:.3f}")
    return figures


def main() -> None:
    words = options(__doc__, rounds=5, cycles=300).parse_args()
    cycles = words.cycles
    ways: dict[str, Callable[[], Figures]] = {
        "Heliarch": partial(launch, OURS, "oahu", cycles),
        f"mosaik {version('mosaik')}": partial(peer, "peer_mosaik.py", cycles),
    }
    title, shown = (
        f"22 nodes, 6 hops in a cycle: {cycles:,} cycles",
        ("cycles_per_s", "processor_ms"),
    )
    measure(title, words.rounds, ways, shown)


if __name__ == "__main__":
    main()
