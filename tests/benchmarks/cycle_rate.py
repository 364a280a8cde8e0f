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

RECORDED: Final = Variant("bare graph")
UNRECORDED: Final = Variant("bare graph, no recorder", recorder=False)
_LAUNCH_LIMIT_S: Final = 300.0


class LaunchFailure(Exception):  # noqa: N818 - what failed is the run, not the program
    """A launch that did not end as it should, with what it said."""


class Memory(msgspec.Struct, frozen=True):
    """The part of a summary's memory that is of interest here."""

    kind: str
    median_mb: float


class Launched(msgspec.Struct, frozen=True):
    """The part of a launch's summary that is of interest here."""

    cycles: int
    cycles_per_s: float
    startup_s: float
    messages_lost: int
    messages: list[dict[str, str | int]]
    memory: list[Memory]

    @property
    def messages_per_cycle(self) -> float:
        """Messages in a cycle, on average; beginning and end of the run included."""
        return sum(int(count["published"]) for count in self.messages) / self.cycles

    def memory_mb(self, kind: str) -> float:
        """Resident memory of the median process of a kind."""
        return next(memory.median_mb for memory in self.memory if memory.kind == kind)


class Round(msgspec.Struct, frozen=True):
    """One launch, and the two bare runs that came right after it."""

    launch: Launched
    bare: BareResult
    unrecorded: BareResult

    @property
    def lost(self) -> int:
        """Messages lost in any of them."""
        return self.launch.messages_lost + self.bare.lost


class Report(msgspec.Struct, frozen=True):
    """All that was measured."""

    machine: str
    scenario: str
    messages_per_cycle: int
    payload_bytes_per_cycle: int
    rounds: list[Round]


def machine_line() -> str:
    """What the figures hold for."""
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return (
        f"{platform.system()} {platform.release()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, Zenoh {version('eclipse-zenoh')}; load average {load}"
    )


def launch(scenario: str, cycles: int) -> Launched:
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
        return msgspec.json.decode(summary.read_bytes(), type=Launched)


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
        Round(
            launch(scenario, cycles),
            run_bare(graph, RECORDED, cycles),
            run_bare(graph, UNRECORDED, cycles),
        )
        for _ in track(range(rounds), "measuring", console=console, transient=True)
    ]


def print_report(report: Report, console: Console) -> None:
    """Print the table."""
    rounds = report.rounds
    launches = [each.launch for each in rounds]
    bare = [each.bare for each in rounds]
    unrecorded = [each.unrecorded for each in rounds]
    cycles = launches[0].cycles
    table = Table(title=f"{report.scenario}: {len(rounds)} rounds of {cycles:,} cycles")
    table.add_column("", no_wrap=True)
    for heading in ("min", "median", "max"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", style="dim")
    mean = statistics.mean(each.messages_per_cycle for each in launches)
    table.add_row(
        "launch, cycles/s",
        *spread([each.cycles_per_s for each in launches]),
        f"recorded, {mean:.1f} messages a cycle",
    )
    size = f"{report.messages_per_cycle} messages a cycle"
    table.add_row(
        "bare graph, cycles/s",
        *spread([each.cycles_per_s for each in bare]),
        f"recorded, {size}",
    )
    table.add_row(
        "  without its recorder, cycles/s",
        *spread([each.cycles_per_s for each in unrecorded]),
        "not recorded",
    )
    table.add_row(
        "launch / bare graph",
        *spread([each.launch.cycles_per_s / each.bare.cycles_per_s for each in rounds], 2),
        "pair by pair",
    )
    table.add_row(
        "launch / bare without recorder",
        *spread([each.launch.cycles_per_s / each.unrecorded.cycles_per_s for each in rounds], 2),
        "pair by pair",
    )
    table.add_section()
    table.add_row(
        "launch, start-up in s",
        *spread([each.startup_s for each in launches], 1),
        "from the command to cycle 0",
    )
    table.add_row(
        "bare graph, start-up in s",
        *spread([each.startup_s for each in bare], 1),
        "from its first process to cycle 0",
    )
    table.add_row(
        "direct controller, memory in MB",
        *spread([each.memory_mb("direct") for each in launches], 1),
        "resident, the median process",
    )
    table.add_row("messages lost", "", f"{sum(each.lost for each in rounds):,}", "", "of all runs")
    console.print(table)
    console.print(report.machine, highlight=False)


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
    report = Report(machine, options.scenario, graph.messages, graph.payload_bytes, rounds)
    print_report(report, console)
    if options.json is not None:
        options.json.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1))
    return 1 if any(each.lost for each in rounds) else 0


if __name__ == "__main__":
    sys.exit(main())
