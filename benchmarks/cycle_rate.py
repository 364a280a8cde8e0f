"""How fast is a launched plant, and how fast could it be? What `make bench` runs.

Each round launches the plant with `heliarch launch --pace max` and runs the bare graph of the same
messages, recorded (see `bare_graph.py`). `before_after.py` compares checkouts.

Processor time is seen from outside: user and system time of the program and all its descendants
while cycles run. The exit status is 0 unless a run failed or messages got lost.
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

import bare_graph
import msgspec
from harness import OURS, Figures, launch, measure, options, run_script

from agents.cycle import stage_of
from agents.team import controllers
from recordings.read.reader import RunReader
from sim_plant.plant import Plant
from sim_plant.profile import load_profile

SAMPLE_CYCLES: Final = 60
SHOWN: Final = ("cycles_per_s", "processor_ms", "startup_s", "own_mb")


def describe(scenario: str, folder: Path) -> Path:
    """Record some cycles; write one of them as the bare graph reads it."""
    launch(OURS, scenario, SAMPLE_CYCLES, keep=folder / "run")
    middle = range(SAMPLE_CYCLES // 2, SAMPLE_CYCLES // 2 + 1)
    puts: dict[tuple[str, str], list[bare_graph.Put]] = defaultdict(list)
    with RunReader(folder / "run") as recording:
        plan = recording.plan
        for record in recording.records(cycles=middle):
            stage = record.port.publisher, stage_of(record.port, plan.tree)
            puts[stage].append(bare_graph.Put(str(record.port), record.payload))
    said = {put.key for of_stage in puts.values() for put in of_stage}
    shape = plan.timing.cycles, len(plan.inverters)
    plant = Plant(plan, load_profile(folder / "run" / "profile.npz", *shape))
    agents = plant, *controllers(plan)
    processes = [
        bare_graph.Process(
            agent.name,
            [str(port) for port in plan.wiring.heard[agent.name] if str(port) in said],
            [
                bare_graph.Stage(
                    [str(port) for port in stage.awaits if str(port) in said],
                    puts[agent.name, stage.name],
                )
                for stage in agent.stages(middle.start)
            ],
        )
        for agent in agents
    ]
    path = folder / "graph.json"
    path.write_bytes(msgspec.json.encode(processes))
    return path


class Bare(Figures, frozen=True, kw_only=True):
    """A run of the bare graph, and the median memory of its processes [MB]."""

    own_mb: float


def bare(graph: Path, cycles: int) -> Bare:
    figures, said = run_script("bare_graph.py", graph, "--cycles", cycles)
    return Bare(**msgspec.structs.asdict(figures), own_mb=said["own_mb"])


def main() -> None:
    parser = options(__doc__, rounds=3, cycles=800)
    parser.add_argument("--scenario", default="oahu")
    words = parser.parse_args()
    scenario, cycles = words.scenario, words.cycles
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        ways: dict[str, Callable[[], Figures]] = {
            "launch": partial(launch, OURS, scenario, cycles),
            "bare graph": partial(bare, describe(scenario, Path(folder)), cycles),
        }
        measure(f"{scenario}: {cycles:,} cycles", words.rounds, ways, SHOWN)


if __name__ == "__main__":
    main()
