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
from typing import Any, Final

import msgspec
from harness import OURS, Failure, Launch, launch, print_table, rounds_of, run, write_figures
from mcap.reader import make_reader

HERE: Final = Path(__file__).parent
SAMPLE_CYCLES: Final = 60


class Bare(msgspec.Struct, frozen=True):
    """What one run of the bare graph came to; the names are those of its document."""

    cycles_per_s: float
    startup_s: float
    processor_ms: float
    switches_per_message: float
    messages: int
    processes: int
    lost: int


class Round(msgspec.Struct, frozen=True):
    """One launch, that of another checkout, and the bare graph, one after the other."""

    launched: Launch
    bare: Bare
    other: Launch | None = None


# The messages of one cycle, as the bare graph takes them ----------------------------------------


def recorded_cycle(recording: Path, cycle: int) -> dict[str, bytes]:
    """Return the payloads of one recorded cycle by their keys."""
    with recording.open("rb") as file:
        return {
            channel.topic: message.data
            for _, channel, message in make_reader(file).iter_messages()
            if msgspec.msgpack.decode(message.data).get("cycle") == cycle
        }


def describe(payloads: dict[str, bytes]) -> dict[str, object]:
    """Lay out the messages of one cycle as processes and stages (see `bare_graph.Graph`).

    The cycle is that of the wire document: plant, direct controllers, supervisors, central
    controller, and back. A message that no stage waits for goes out with its node's report.
    """
    nodes: dict[str, set[str]] = defaultdict(set)
    for key in payloads:
        node, signal = key.rsplit("/", 1)
        nodes[node].add(signal)
    root = min(nodes, key=len)
    parents = {node: node.rsplit("/", 1)[0] for node in nodes if node != root}
    leaves = [node for node in nodes if "telemetry" in nodes[node]]
    inner = sorted({*parents.values()}, key=lambda node: (node.count("/"), node))

    def said(node: str, *signals: str) -> list[str]:
        return [f"{node}/{signal}" for signal in signals if signal in nodes[node]]

    def each(several: Iterable[str], *signals: str) -> list[str]:
        return [key for node in several for key in said(node, *signals)]

    def stage(awaits: list[str], puts: list[str]) -> dict[str, list[Any]]:
        return {"awaits": awaits, "puts": [{"key": key, "payload": payloads[key]} for key in puts]}

    world = said(root, "dispatch", "meter") + each(leaves, "telemetry")
    report = ("impp", "residual", "help")
    processes: list[dict[str, object]] = []

    def process(name: str, also: list[str], *stages: dict[str, list[Any]]) -> None:
        hears = dict.fromkeys([*also, *(key for one in stages for key in one["awaits"])])
        processes.append({"name": name, "hears": list(hears), "stages": stages})

    commands = each(leaves, "command")
    process("plant", [], stage([], world), stage(commands, said(root, "production")))
    dispatch = said(root, "dispatch")
    for node in inner:
        children = [child for child, parent in parents.items() if parent == node]
        reports, solved = each(children, "impp", "residual"), each(children, "setpoint")
        if node == root:
            heard = [*reports, *said(root, "dispatch", "meter")]
            process("central", [], stage(heard, said(root, *report) + solved))
        else:
            up = stage(reports, said(node, *report))
            process(node, dispatch, up, stage(said(node, "setpoint"), solved))
    for node in leaves:
        up = stage([*said(node, "telemetry"), *dispatch], said(node, *report))
        process(node, [], up, stage(said(node, "setpoint"), said(node, "command")))
    return {"processes": processes}


def describe_scenario(scenario: str, folder: Path) -> Path:
    """Record some cycles and write the description of one of them."""
    launch(OURS, scenario, SAMPLE_CYCLES, keep=folder / "run")
    path = folder / "graph.json"
    (recording,) = (folder / "run").glob("*.mcap")
    path.write_bytes(msgspec.json.encode(describe(recorded_cycle(recording, SAMPLE_CYCLES // 2))))
    return path


def bare(graph: Path, cycles: int) -> Bare:
    """Run the bare graph with its recorder."""
    watched = run(
        [sys.executable, str(HERE / "bare_graph.py"), str(graph), "--cycles", str(cycles)]
    )
    return msgspec.json.decode(watched.output.splitlines()[-1], type=Bare)


# What is printed --------------------------------------------------------------------------------


def rows_of(rounds: Sequence[Round]) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table: name, least, median and most of all rounds, note."""
    bares = [each.bare for each in rounds]
    launches = {"launch": [each.launched for each in rounds]}
    others = [each.other for each in rounds if each.other is not None]
    if others:
        launches["the other checkout"] = others

    def row(name: str, values: Iterable[float], digits: int, note: str) -> tuple[str, ...]:
        known = [value for value in values if not isnan(value)] or [nan]
        figures = min(known), statistics.median(known), max(known)
        return name, *(f"{value:,.{digits}f}" for value in figures), note

    def each_launch(field: str, what: str, digits: int, note: str) -> Iterator[tuple[str, ...]]:
        for name, found in launches.items():
            yield row(f"{name}, {what}", (getattr(each, field) for each in found), digits, note)

    messages = bares[0].messages
    yield from each_launch("cycles_per_s", "cycles/s", 0, "recorded")
    yield row("bare graph, cycles/s", (each.cycles_per_s for each in bares), 0, "recorded")
    for name, against in (("bare graph", bares), ("the other checkout", others)):
        if against:
            pairs = zip(launches["launch"], against, strict=True)
            ratios = (one.cycles_per_s / other.cycles_per_s for one, other in pairs)
            yield row(f"launch / {name}", ratios, 2, "round by round")
    yield from each_launch("processor_ms", "processor time", 1, "ms a cycle")
    yield row("bare graph, processor time", (each.processor_ms for each in bares), 1, "ms a cycle")
    switches = (each.switches_per_message for each in bares)
    yield row("bare graph, switches", switches, 1, f"per message, {messages} a cycle")
    yield from each_launch("startup_s", "start-up", 2, "s, command to cycle 0")
    yield row(
        "bare graph, start-up", (each.startup_s for each in bares), 2, "s, fork to all linked"
    )
    yield from each_launch("own_mb", "direct controller", 1, "MB, its own")
    yield from each_launch("resident_mb", "direct controller", 1, "MB, resident")


def main() -> int:
    """Measure, print, write. Returns the exit status."""
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
            graph = describe_scenario(scenario, Path(folder))
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
