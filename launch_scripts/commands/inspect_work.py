"""`heliarch inspect`: what a recording holds, one node's story, or the plant in one cycle."""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bus_schemas.errors import InputError
from launch_scripts.commands.reading_progress import reading_progress
from launch_scripts.commands.termination import leaving_on_sigterm
from launch_scripts.launcher.json_rows import check_json_destination, json_rows
from recordings.inspect.overview import Overview, read_overview
from recordings.inspect.story import NodeCycle, story
from recordings.inspect.story_table import WIDTH, StoryTable, plant_lines
from recordings.read.damage import damage_text
from recordings.read.reader import RunReader
from recordings.read.selection import find_node

_SHOWN_GAPS: Final = 10
_INTERRUPTED: Final = 130
_NAME_WIDTH: Final = 12


@dataclass(frozen=True, slots=True)
class InspectRequest:
    """The words of the command line, None where the user said nothing."""

    run: Path
    node: str | None
    start: str | None
    end: str | None
    cycle: str | None
    json: str | None


def inspect(request: InspectRequest) -> int:
    """Show what was asked for of a recording. Returns the exit status."""
    console = _console(to_stderr=request.json == "-")
    try:
        _check(request)
        with RunReader(request.run, skip_damaged=True) as run, leaving_on_sigterm():
            _show(run, request, console)
            damage = damage_text(run)
    except InputError as error:
        sys.stderr.write(f"heliarch: {error}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("heliarch: interrupted\n")
        return _INTERRUPTED
    except BrokenPipeError:
        # `heliarch inspect ... | head`: nobody reads on, and that is no error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        sys.stderr.write(f"heliarch: inspect: {error}\n")
        return 1
    if damage:
        sys.stderr.write(f"heliarch: {damage}\n")
    return 0


def _console(*, to_stderr: bool) -> Console:
    """Return a console on which tables keep their columns, also in a pipe."""
    console = Console(stderr=to_stderr)
    return console if console.is_terminal else Console(stderr=to_stderr, width=WIDTH)


def _check(request: InspectRequest) -> None:
    if request.cycle is not None and (request.start or request.end or request.node):
        raise InputError("--cycle: the whole plant in one cycle, accepted without --node and span")
    check_json_destination(request.json)


def _show(run: RunReader, request: InspectRequest, console: Console) -> None:
    if request.cycle is not None:
        _show_plant(run, run.clock.cycle(request.cycle), request.json, console)
        return
    cycles = None
    if request.start is not None or request.end is not None:
        cycles = run.clock.span(request.start, request.end)
    if request.node is not None:
        node = find_node(run.plan.tree, request.node)
        _show_story(run, node, cycles or run.clock.span(None, None), request.json, console)
        return
    _show_overview(run, cycles, request.json, console)


# One node, cycle by cycle --------------------------------------------------------------------


def _show_story(
    run: RunReader, node: str, cycles: range, json: str | None, console: Console
) -> None:
    table = StoryTable(run.plan.tree, node, len(run.clock.text(0)))
    _print_lines(console, table.heading(), "bold")
    with json_rows(json) as listed:
        for rows in story(run, [node], cycles):
            for row in rows:
                _print_lines(console, table.row(row), _style(row))
                listed.write(row)
    _warn_if_cut(run, console)


def _style(row: NodeCycle) -> str:
    """Let those stand out who need help, and those who had to go without something."""
    return "red" if row.help_asked_kw else "yellow" if row.missing or row.stale_cycles else ""


# The plant in one cycle ----------------------------------------------------------------------


def _show_plant(run: RunReader, cycle: int, json: str | None, console: Console) -> None:
    found = next(story(run, run.plan.tree.nodes, range(cycle, cycle + 1)), None)
    if found is None:
        nothing = f"{run.path}: there is no message of cycle {cycle}, {run.clock.extent()}"
        raise InputError(damage_text(run) or nothing)
    central = found[0]
    _print_lines(console, [f"cycle {cycle}, {run.clock.local(cycle):%Y-%m-%d} {central.time}"])
    _print_lines(console, [_plant_text(central)])
    heading, units, *lines = plant_lines(run.plan.tree, found)
    _print_lines(console, ["", heading, units], "bold")
    _print_lines(console, lines)
    with json_rows(json) as listed:
        for row in found:
            listed.write(row)
    _warn_if_cut(run, console)


def _plant_text(central: NodeCycle) -> str:
    """Say what was wanted of the plant, what it could have given and what it gave."""

    def text(value_kw: float | None) -> str:
        return "not recorded" if value_kw is None else f"{value_kw:.2f} kW"

    return (
        f"dispatch {text(central.dispatch_kw)} (commitment {text(central.commitment_kw)}), "
        f"possible {text(central.possible_kw)}, produced {text(central.delivered_kw)}"
    )


def _print_lines(console: Console, lines: Iterable[str], style: str = "") -> None:
    for line in lines:
        console.print(Text(line, style), soft_wrap=True)


# The whole recording -------------------------------------------------------------------------


def _show_overview(
    run: RunReader, cycles: range | None, json: str | None, console: Console
) -> None:
    with reading_progress("reading") as follow:
        overview = read_overview(run, cycles, follow)
    for name, value in _facts(overview):
        first, *rest = textwrap.wrap(value, WIDTH - _NAME_WIDTH, break_long_words=False) or [""]
        console.print(Text.assemble((name.ljust(_NAME_WIDTH), "bold"), first), soft_wrap=True)
        _print_lines(console, (" " * _NAME_WIDTH + line for line in rest))
    console.print(_signal_table(overview))
    _print_lines(console, _gap_lines(run, overview))
    _warn_if_cut(run, console)
    if json == "-":
        sys.stdout.write(_document(overview).decode())
    elif json is not None:
        Path(json).write_bytes(_document(overview))


def _facts(overview: Overview) -> Iterator[tuple[str, str]]:
    yield "recording", f"{overview.path} ({overview.size_mb:,.1f} MB, {overview.chunks:,} chunks)"
    yield "scenario", overview.title or overview.plant
    yield "run", f"{overview.run_id}, heliarch {overview.driver}"
    pace = "lockstep" if overview.lockstep else f"pace {overview.pace:g}"
    yield "control", f"scheme {overview.scheme}, actuator {overview.actuator}, {pace}"
    begin, end = (text.replace("T", " ")[:19] for text in (overview.start, overview.end))
    yield "time", f"{begin} to {end}, {overview.timezone}"
    yield (
        "cycles",
        f"{overview.first_cycle:,} to {overview.last_cycle:,} of {overview.cycle_s:g} s, "
        f"{overview.complete_cycles:,} complete, {overview.planned_cycles:,} planned",
    )
    yield "duration", f"{overview.simulated_s:,.0f} s simulated in {overview.wall_s:,.1f} s"
    origin = overview.origin
    versions = [f"{name} {text}" for name, text in overview.versions.items()]
    yield "versions", ", ".join([*versions, f"Python {origin.get('python', 'not stated')}"])
    if "host" in origin:  # A run in memory does not depend on it.
        cpus, kernel = origin.get("cpu_count", "?"), origin.get("kernel", "?")
        yield "host", f"{origin['host']}, {cpus} CPUs, Linux {kernel}"
    yield "file", f"{'whole' if overview.whole else 'cut'}{_recovered(overview)}"


def _recovered(overview: Overview) -> str:
    """Say that a file was recovered, and whether anything may be missing in it."""
    if not overview.recovery:
        return ""
    lossless = overview.recovery.get("lossless") == "true"
    return (
        f", recovered from {overview.recovery.get('recovered_from', 'another file')}, "
        f"{'nothing' if lossless else 'something'} is missing"
    )


def _signal_table(overview: Overview) -> Table:
    table = Table(title=f"{overview.messages:,} messages")
    table.add_column("signal", no_wrap=True)
    headings = ("nodes", "messages", "per cycle", "per s", "lost", "repeated", "cycles without")
    for heading in headings:
        table.add_column(heading, justify="right")
    for count in overview.signals:
        table.add_row(
            count.signal,
            f"{count.nodes:,}",
            f"{count.messages:,}",
            f"{count.per_cycle:,.2f}",
            f"{count.per_s:,.1f}",
            f"{count.lost:,}",
            f"{count.repeated:,}",
            f"{count.missing_cycles:,}",
        )
    return table


def _gap_lines(run: RunReader, overview: Overview) -> Iterator[str]:
    for gap in overview.gaps[:_SHOWN_GAPS]:
        begin, end = run.clock.text(gap.first_cycle), run.clock.text(gap.last_cycle)
        yield (
            f"{gap.port}: none in {gap.cycles:,} cycles, {gap.first_cycle:,} to "
            f"{gap.last_cycle:,} ({begin} to {end})"
        )
    rest = len(overview.gaps) - _SHOWN_GAPS + overview.more_gaps
    if rest > 0:
        yield f"and {rest:,} more gaps" + (" (--json has the first 100)" if rest else "")


def _document(overview: Overview) -> bytes:
    return msgspec.json.format(msgspec.json.encode(overview), indent=1) + b"\n"


def _warn_if_cut(run: RunReader, console: Console) -> None:
    if not run.whole:
        text = (
            f"{run.path} was cut, or is still being recorded: this is what it holds. "
            "`heliarch recover` makes a whole file of it."
        )
        console.print(Text(text, "yellow"))
