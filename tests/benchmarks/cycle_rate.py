"""How fast is a launched plant, and how fast could it be? What `make bench` runs.

Launches the plant with `heliarch launch --pace max`, then runs the bare graph of the same plan
(see bare_graph.py) with and without its recorder, and again, in turn: whatever else the machine
does meets all three alike, so the ratio of neighbours holds where the figures themselves do not.

    python tests/benchmarks/cycle_rate.py --rounds 5 --json bench.json

The exit status is 0 unless a run failed or messages got lost. How fast it was does not matter.
"""

from __future__ import annotations

import argparse
import os
import platform
import signal
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec
from bare_graph import BareFailure, BareResult, Graph, Variant, graph_of, run_bare
from rich.console import Console
from rich.progress import track
from rich.table import Table

from launch_scripts.summary import RunSummary

RECORDED: Final = Variant("bare graph")
UNRECORDED: Final = Variant("bare graph, no recorder", recorder=False)
_LAUNCH_LIMIT_S: Final = 300.0


class LaunchFailure(Exception):  # noqa: N818 - what failed is the run, not the program
    """A launch that did not end as it should, with what it said."""


class Round(msgspec.Struct, frozen=True):
    """One launch, and the two bare runs that came right after it.

    Memory is that of the median direct controller: what is resident, and what is its own, without
    the libraries that processes share.
    """

    launch_cycles_per_s: float
    bare_cycles_per_s: float
    unrecorded_cycles_per_s: float
    launch_startup_s: float
    bare_startup_s: float
    messages_per_cycle: float
    direct_resident_mb: float
    direct_own_mb: float
    lost: int


class Report(msgspec.Struct, frozen=True):
    """All that was measured."""

    machine: str
    scenario: str
    cycles: int
    messages_per_cycle: int
    rounds: list[Round]


def machine_line() -> str:
    """What the figures hold for."""
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return (
        f"{platform.system()} {platform.release()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, Zenoh {version('eclipse-zenoh')}; load average {load}"
    )


def launch(scenario: str, cycles: int) -> RunSummary:
    """Launch a scenario in lockstep, in a folder that is thrown away.

    Raises
    ------
    LaunchFailure
        It failed, or took too long.
    """
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        summary = Path(folder) / "summary.json"
        # Cycles are of one second in the scenarios that come with the project.
        command = [sys.executable, "-m", "launch_scripts", "launch", scenario, "--pace", "max"]
        command += ["--duration", f"{cycles}s", "--out", f"{folder}/run", "--json", str(summary)]
        status, said = _run(command)
        if not summary.exists():
            raise LaunchFailure(f"heliarch launch ended with status {status}:\n{said}")
        return msgspec.json.decode(summary.read_bytes(), type=RunSummary)


def _run(command: Sequence[str]) -> tuple[int, str]:
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, process_group=0
    )
    try:
        said, _ = process.communicate(timeout=_LAUNCH_LIMIT_S)
    except BaseException as error:
        # On SIGTERM it ends its own processes.
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=20.0)
        if isinstance(error, subprocess.TimeoutExpired):
            raise LaunchFailure(f"heliarch launch took over {_LAUNCH_LIMIT_S:g} s") from None
        raise
    return process.returncode, said


def spread(values: Sequence[float], digits: int = 0) -> tuple[str, str, str]:
    """Return smallest, median and largest value, to be read."""
    chosen = min(values), statistics.median(values), max(values)
    low, middle, high = (f"{value:,.{digits}f}" for value in chosen)
    return low, middle, high


def measure(scenario: str, graph: Graph, rounds: int, cycles: int, console: Console) -> list[Round]:
    """Run launch and bare graph in turn."""
    return [
        _round(
            launch(scenario, cycles),
            run_bare(graph, RECORDED, cycles),
            run_bare(graph, UNRECORDED, cycles),
        )
        for _ in track(range(rounds), "measuring", console=console, transient=True)
    ]


def _round(launched: RunSummary, bare: BareResult, unrecorded: BareResult) -> Round:
    (memory,) = (use for use in launched.memory if use.kind == "direct")
    return Round(
        launch_cycles_per_s=launched.cycles_per_s,
        bare_cycles_per_s=bare.cycles_per_s,
        unrecorded_cycles_per_s=unrecorded.cycles_per_s,
        launch_startup_s=launched.startup_s,
        bare_startup_s=bare.startup_s,
        messages_per_cycle=sum(count.published for count in launched.messages) / launched.cycles,
        direct_resident_mb=memory.resident_median_mb,
        direct_own_mb=memory.own_median_mb,
        lost=launched.lost + bare.lost,
    )


def print_report(report: Report, console: Console) -> None:
    """Print the table."""
    rounds = report.rounds
    table = Table(title=f"{report.scenario}: {len(rounds)} rounds of {report.cycles:,} cycles")
    table.add_column("", no_wrap=True)
    for heading in ("min", "median", "max"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", style="dim", no_wrap=True)

    def row(name: str, values: list[float], digits: int, note: str) -> None:
        table.add_row(name, *spread(values, digits), note)

    mean = statistics.mean(each.messages_per_cycle for each in rounds)
    launched = [each.launch_cycles_per_s for each in rounds]
    bare = [each.bare_cycles_per_s for each in rounds]
    unrecorded = [each.unrecorded_cycles_per_s for each in rounds]
    row("launch, cycles/s", launched, 0, f"recorded, {mean:.1f} messages a cycle")
    row("bare graph, cycles/s", bare, 0, f"recorded, {report.messages_per_cycle} messages a cycle")
    row("  without its recorder, cycles/s", unrecorded, 0, "")
    row("launch / bare graph", _ratios(launched, bare), 2, "round by round")
    row("launch / bare without recorder", _ratios(launched, unrecorded), 2, "round by round")
    table.add_section()
    startups = [each.launch_startup_s for each in rounds]
    row("launch, start-up in s", startups, 1, "from the command to cycle 0")
    startups = [each.bare_startup_s for each in rounds]
    row("bare graph, start-up in s", startups, 1, "from its first process to cycle 0")
    resident = [each.direct_resident_mb for each in rounds]
    row("direct controller, memory in MB", resident, 1, "resident")
    row("", [each.direct_own_mb for each in rounds], 1, "its own, without shared libraries")
    table.add_row("messages lost", "", f"{sum(each.lost for each in rounds):,}", "", "in all runs")
    console.print(table)
    console.print(report.machine, highlight=False)


def _ratios(values: list[float], others: list[float]) -> list[float]:
    return [value / other for value, other in zip(values, others, strict=True)]


def main() -> int:
    """Measure, print, write. Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="oahu")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cycles", type=int, default=800)
    parser.add_argument("--json", type=Path, metavar="PATH", help="write all figures as JSON")
    options = parser.parse_args()
    console = Console(width=100)
    machine = machine_line()
    try:
        graph = graph_of(options.scenario, options.cycles)
        rounds = measure(options.scenario, graph, options.rounds, options.cycles, console)
    except (LaunchFailure, BareFailure) as failure:
        sys.stderr.write(f"cycle rate: {failure}\n")
        return 1
    report = Report(machine, options.scenario, options.cycles, graph.messages, rounds)
    print_report(report, console)
    if options.json is not None:
        options.json.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1))
    return 1 if any(each.lost for each in rounds) else 0


if __name__ == "__main__":
    sys.exit(main())
