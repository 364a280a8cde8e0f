"""How fast is a launched plant, and how fast could it be? What `make bench` runs.

Each round launches the plant with `heliarch launch --pace max` and then runs the bare graph of the
same messages, recorded (see `bare_graph.py`): what else the machine does meets both, so ratios of
one round hold where the figures themselves do not. Another checkout with a `.venv` of its own can
be launched in the same rounds, for before and after:

    python benchmarks/cycle_rate.py --rounds 5 --other ../before --json bench.json

Processor time of a launch is seen from outside: user and system time of the launcher and all its
descendants while cycles run. The bare graph counts its own, in all its processes. The exit status
is 0 unless a run failed or messages got lost. How fast it was does not matter.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from math import isnan, nan
from pathlib import Path
from typing import Final

import bare_graph
import msgspec
from harness import OURS, Failure, Launch, launch, print_table, rounds_of, run, write_figures

from agents.cycle import stage_of
from agents.team import controllers
from recordings import open_run
from sim_plant.plant import Plant
from sim_plant.profile import load_profile

SAMPLE_CYCLES: Final = 60


class Round(msgspec.Struct, frozen=True):
    """One launch, that of another checkout, and the bare graph, one after the other."""

    launched: Launch
    bare: bare_graph.Figures
    other: Launch | None = None


def describe(scenario: str, folder: Path) -> Path:
    """Record some cycles; write one of them as the bare graph reads it (see `bare_graph.Graph`)."""
    launch(OURS, scenario, SAMPLE_CYCLES, keep=folder / "run")
    middle = range(SAMPLE_CYCLES // 2, SAMPLE_CYCLES // 2 + 1)
    puts: dict[tuple[str, str], list[bare_graph.Put]] = defaultdict(list)
    with open_run(folder / "run") as recording:
        plan = recording.plan
        for record in recording.records(cycles=middle):
            stage = record.port.publisher, stage_of(record.port, plan.tree)
            puts[stage].append(bare_graph.Put(str(record.port), record.payload))
    said = {put.key for of_stage in puts.values() for put in of_stage}
    agents = Plant(plan, load_profile(folder / "run" / "profile.npz")), *controllers(plan)
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
    path.write_bytes(msgspec.json.encode(bare_graph.Graph(processes)))
    return path


def bare(graph: Path, cycles: int) -> bare_graph.Figures:
    watched = run([sys.executable, bare_graph.__file__, str(graph), "--cycles", str(cycles)])
    return msgspec.json.decode(watched.output.splitlines()[-1], type=bare_graph.Figures)


FIGURES: Final = (
    ("cycles_per_s", "cycles/s", 0, "recorded"),
    ("processor_ms", "processor time", 1, "ms a cycle"),
    ("switches_per_message", "switches", 1, "per message"),
    ("startup_s", "start-up", 2, "s: command to cycle 0; bare graph: fork to all linked"),
    ("own_mb", "direct controller", 1, "MB, its own"),
    ("resident_mb", "direct controller", 1, "MB, resident"),
)
"""Field of a run, what it is called, its decimals, a note."""


def rows_of(rounds: Sequence[Round]) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table: name, least, median and most of all rounds, note."""
    launches = [each.launched for each in rounds]
    others = [each.other for each in rounds if each.other is not None]
    bares = [each.bare for each in rounds]
    runs: dict[str, Sequence[Launch | bare_graph.Figures]] = {
        "launch": launches,
        "the other checkout": others,
        "bare graph": bares,
    }

    def row(name: str, values: Iterable[float], digits: int, note: str) -> tuple[str, ...]:
        known = [value for value in values if not isnan(value)] or [nan]
        figures = min(known), statistics.median(known), max(known)
        return name, *(f"{value:,.{digits}f}" for value in figures), note

    for name in ("bare graph", "the other checkout"):
        pairs = zip(launches, runs[name], strict=False)  # There may be no other checkout.
        if ratios := [one.cycles_per_s / other.cycles_per_s for one, other in pairs]:
            yield row(f"launch / {name}, cycles/s", ratios, 2, "round by round")
    for field, what, digits, note in FIGURES:
        for name, found in runs.items():
            if values := [getattr(each, field) for each in found if hasattr(each, field)]:
                yield row(f"{name}, {what}", values, digits, note)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="oahu")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cycles", type=int, default=800)
    parser.add_argument("--other", type=Path, metavar="DIR", help="another checkout to set beside")
    parser.add_argument("--json", type=Path, metavar="PATH", help="write all figures as JSON")
    options = parser.parse_args()
    scenario, cycles = options.scenario, options.cycles
    rounds: list[Round] = []
    try:
        with tempfile.TemporaryDirectory(prefix="bench-") as folder:
            graph = describe(scenario, Path(folder))
            for _ in rounds_of(options.rounds):
                launched = launch(OURS, scenario, cycles)
                other = options.other and launch(
                    options.other / ".venv/bin/heliarch", scenario, cycles
                )
                rounds.append(Round(launched, bare(graph, cycles), other))
    except Failure as failure:
        sys.stderr.write(f"cycle rate: {failure}\n")
        return 1
    title = f"{scenario}: {options.rounds} rounds of {cycles:,} cycles"
    print_table(title, ("", "min", "median", "max", ""), rows_of(rounds))
    write_figures(rounds, options.json)
    lost = sum(each.launched.lost + each.bare.lost for each in rounds)
    if lost:
        sys.stderr.write(f"cycle rate: {lost:,} messages lost\n")
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
