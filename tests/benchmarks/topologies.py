"""Which links between the processes, and which of Zenoh's settings?

Runs the bare graph (see bare_graph.py) in variants that differ from the project's choice in one
thing each, in turn, round by round. First in lockstep: how many cycles per second. Then in real
time, where a message that finds no room in time is dropped: how many are lost.

    python tests/benchmarks/topologies.py --rounds 5

The exit status is 0 unless a run failed or lost messages in lockstep.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
from bare_graph import BareFailure, BareResult, Graph, Variant, graph_of, run_bare
from cycle_rate import machine_line, spread
from rich.console import Console
from rich.progress import track
from rich.table import Table

LOCKSTEP: Final = (
    Variant("explicit links"),
    Variant("mesh by gossip", "mesh"),
    Variant("router", "router"),
    Variant("explicit, Zenoh's threads", one_thread=False),
    Variant("explicit, express", express=True),
    Variant("explicit, Zenoh's callbacks", indirect=False),
    Variant("explicit, woken per message", wake_per_message=True),
)
"""The first is the project's choice."""


def real_time(rate_hz: float) -> tuple[Variant, ...]:
    """Return the variants that run in real time; the first is the project's choice."""
    return (
        Variant("batched, 20 ms patience", rate_hz=rate_hz),
        Variant("express, 20 ms patience", rate_hz=rate_hz, express=True),
        Variant("batched, 1 ms patience", rate_hz=rate_hz, patience_us=1_000),
        Variant("express, 1 ms patience", rate_hz=rate_hz, express=True, patience_us=1_000),
    )


class Figures(msgspec.Struct):
    """What one variant came to, round by round; None where the run failed."""

    variant: Variant
    rounds: list[BareResult | None]
    failures: list[str]

    @property
    def results(self) -> list[BareResult]:
        """Rounds that went through."""
        return [result for result in self.rounds if result is not None]


class Report(msgspec.Struct, frozen=True):
    """All that was measured."""

    machine: str
    scenario: str
    messages_per_cycle: int
    lockstep: list[Figures]
    real_time: list[Figures]


def measure(
    graph: Graph, variants: Sequence[Variant], rounds: int, cycles: int, console: Console
) -> list[Figures]:
    """Run each variant once in each round; each round begins with another one."""
    figures = [Figures(variant, [], []) for variant in variants]
    turns = [
        figures[(number + place) % len(figures)]
        for number in range(rounds)
        for place in range(len(figures))
    ]
    for each in track(turns, "measuring", console=console, transient=True):
        try:
            each.rounds.append(run_bare(graph, each.variant, cycles))
        except BareFailure as failure:
            each.rounds.append(None)
            each.failures.append(str(failure))
    return figures


def print_lockstep(figures: Sequence[Figures], title: str, console: Console) -> None:
    """Print the table of cycle rates."""
    table = Table(title=title)
    table.add_column("", no_wrap=True)
    for heading in ("min", "median", "max", "ratio", "CPU", "start-up", "lost", "failed"):
        table.add_column(heading, justify="right", no_wrap=True)
    for each in figures:
        if not each.results:
            table.add_row(each.variant.name, *["-"] * 7, str(len(each.failures)))
            continue
        table.add_row(
            each.variant.name,
            *spread([result.cycles_per_s for result in each.results]),
            _ratio(each.rounds, figures[0].rounds),
            f"{statistics.median(result.cpu_ms for result in each.results):.1f} ms",
            f"{statistics.median(result.startup_s for result in each.results):.1f} s",
            f"{sum(result.lost for result in each.results):,}",
            str(len(each.failures)),
        )
    table.caption = (
        "min, median, max: cycles/s; ratio: to the first row's, round by round, the median;\n"
        "CPU: processor time of all processes in a cycle, the median"
    )
    console.print(table)


def _ratio(rounds: Sequence[BareResult | None], chosen: Sequence[BareResult | None]) -> str:
    ratios = [
        one.cycles_per_s / other.cycles_per_s
        for one, other in zip(rounds, chosen, strict=True)
        if one is not None and other is not None
    ]
    return f"{statistics.median(ratios):.2f}" if ratios else "-"


def print_real_time(figures: Sequence[Figures], title: str, console: Console) -> None:
    """Print the table of losses."""
    table = Table(title=title)
    table.add_column("", no_wrap=True)
    for heading in ("sent", "lost", "share", "cycles", "not closed", "failed"):
        table.add_column(heading, justify="right", no_wrap=True)
    for each in figures:
        sent = sum(result.sent for result in each.results)
        lost = sum(result.lost for result in each.results)
        table.add_row(
            each.variant.name,
            f"{sent:,}",
            f"{lost:,}",
            f"{100.0 * lost / sent:.2f} %" if sent else "-",
            f"{sum(result.cycles for result in each.results):,}",
            f"{sum(result.unfinished for result in each.results):,}",
            str(len(each.failures)),
        )
    table.caption = "lost: on the way to the recorder; not closed: without all commands in time"
    console.print(table)


def main() -> int:
    """Measure, print, write. Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="oahu")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cycles", type=int, default=800, help="of each run in lockstep")
    parser.add_argument("--rate", type=float, default=20.0, help="cycles per second in real time")
    parser.add_argument("--real-time-cycles", type=int, default=120, help="of each such run")
    parser.add_argument(
        "--only", metavar="WORD", help="in lockstep: the first variant, and those named so"
    )
    parser.add_argument("--json", type=Path, metavar="PATH", help="write all figures as JSON")
    options = parser.parse_args()
    console = Console(width=100)
    machine = machine_line()
    try:
        graph = graph_of(options.scenario, options.cycles)
    except BareFailure as failure:
        sys.stderr.write(f"topologies: {failure}\n")
        return 1
    variants = [v for v in LOCKSTEP if v is LOCKSTEP[0] or (options.only or "") in v.name]
    lockstep = measure(graph, variants, options.rounds, options.cycles, console)
    title = f"{options.scenario}, {graph.messages} messages a cycle, {options.rounds} rounds"
    print_lockstep(lockstep, f"{title} of {options.cycles:,} cycles, lockstep", console)
    timed = []
    if options.only is None:
        timed = measure(
            graph, real_time(options.rate), options.rounds, options.real_time_cycles, console
        )
        print_real_time(timed, f"{title} at {options.rate:g} cycles/s, messages may drop", console)
    console.print(machine, highlight=False)
    if options.json is not None:
        report = Report(machine, options.scenario, graph.messages, lockstep, timed)
        options.json.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1))
    return _status([*lockstep, *timed], console)


def _status(figures: Sequence[Figures], console: Console) -> int:
    failures = [f"{each.variant.name}: {text}" for each in figures for text in each.failures]
    for failure in failures:
        console.print(failure, highlight=False, markup=False)
    lost = sum(
        result.lost for each in figures if not each.variant.rate_hz for result in each.results
    )
    return 1 if failures or lost else 0


if __name__ == "__main__":
    sys.exit(main())
