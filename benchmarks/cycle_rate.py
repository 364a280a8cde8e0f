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
import os
import platform
import statistics
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from math import isnan, nan
from pathlib import Path
from typing import Any, Final

import msgspec
from launched import Launch, launch
from mcap.reader import make_reader
from outside import Failure, run
from rich.console import Console
from rich.table import Table

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


def describe_scenario(heliarch: Path, scenario: str, folder: Path) -> Path:
    """Record some cycles and write the description of one of them."""
    launch(heliarch, scenario, SAMPLE_CYCLES, keep=folder / "run")
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


def print_report(rounds: Sequence[Round], title: str, console: Console) -> None:
    """Print the table."""
    table = Table(title=title)
    table.add_column("", no_wrap=True)
    for heading in ("min", "median", "max"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", style="dim", no_wrap=True)

    def row(name: str, values: Sequence[float], digits: int, note: str = "") -> None:
        known = [value for value in values if not isnan(value)] or [nan]
        low, middle, high = min(known), statistics.median(known), max(known)
        table.add_row(name, *(f"{value:,.{digits}f}" for value in (low, middle, high)), note)

    launched, bares = [each.launched for each in rounds], [each.bare for each in rounds]
    others = [each.other for each in rounds if each.other is not None]
    several = [("launch", launched)] + ([("the other checkout", others)] if others else [])
    for name, launches in several:
        per_cycle = statistics.mean(each.messages / each.cycles for each in launches)
        row(f"{name}, cycles/s", [each.cycles_per_s for each in launches], 0, _count(per_cycle))
    row("bare graph, cycles/s", [each.cycles_per_s for each in bares], 0, _count(bares[0].messages))
    row("launch / bare graph", _ratios(launched, bares), 2, "round by round")
    if others:
        row("launch / the other checkout", _ratios(launched, others), 2, "round by round")
    table.add_section()
    for name, launches in several:
        row(f"{name}, processor time", [each.processor_ms for each in launches], 1, "ms a cycle")
    row("bare graph, processor time", [each.processor_ms for each in bares], 1, "ms a cycle")
    row("bare graph, switches", [each.switches_per_message for each in bares], 1, "per message")
    table.add_section()
    for name, launches in several:
        row(f"{name}, start-up", [each.startup_s for each in launches], 2, "s, command to cycle 0")
    row("bare graph, start-up", [each.startup_s for each in bares], 2, "s, fork to all linked")
    for name, launches in several:
        row(f"{name}, direct controller", [each.own_mb for each in launches], 1, "MB, its own")
        row("", [each.resident_mb for each in launches], 1, "MB, resident")
    console.print(table)


def _count(messages: float) -> str:
    return f"recorded, {messages:.1f} messages a cycle"


def _ratios(ours: Sequence[Launch], theirs: Sequence[Launch | Bare]) -> list[float]:
    return [one.cycles_per_s / other.cycles_per_s for one, other in zip(ours, theirs, strict=True)]


def main() -> int:
    """Measure, print, write. Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="oahu")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cycles", type=int, default=800)
    parser.add_argument("--other", type=Path, metavar="DIR", help="another checkout to set beside")
    parser.add_argument("--json", type=Path, metavar="PATH", help="write all figures as JSON")
    options = parser.parse_args()
    console = Console(width=110)
    heliarch = Path(sys.executable).parent / "heliarch"
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    rounds: list[Round] = []
    try:
        with tempfile.TemporaryDirectory(prefix="bench-") as folder:
            graph = describe_scenario(heliarch, options.scenario, Path(folder))
            for number in range(options.rounds):
                sys.stderr.write(f"round {number + 1} of {options.rounds}\n")
                launched = launch(heliarch, options.scenario, options.cycles)
                other = options.other and launch(
                    options.other / ".venv/bin/heliarch", options.scenario, options.cycles
                )
                rounds.append(Round(launched, bare(graph, options.cycles), other))
    except Failure as failure:
        sys.stderr.write(f"cycle rate: {failure}\n")
        return 1
    title = f"{options.scenario}: {options.rounds} rounds of {options.cycles:,} cycles"
    print_report(rounds, title, console)
    console.print(
        f"{platform.system()} {platform.release()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, Zenoh {version('eclipse-zenoh')}; "
        f"load average before {load}",
        highlight=False,
    )
    if options.json is not None:
        options.json.write_bytes(msgspec.json.format(msgspec.json.encode(rounds), indent=1))
    lost = sum(each.launched.lost + each.bare.lost for each in rounds)
    if lost:
        sys.stderr.write(f"cycle rate: {lost:,} messages lost\n")
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
