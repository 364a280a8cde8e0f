"""`heliarch inspect`: what a recording holds, one node's story, or the plant in one cycle."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
from rich.console import Console
from rich.text import Text

from bus_schemas.errors import InputError
from launch_scripts.commands.reading_progress import reading_progress
from launch_scripts.commands.termination import leaving_on_sigterm
from launch_scripts.launcher.json_rows import check_json_destination, json_rows
from recordings.inspect.overview import Overview, read_overview
from recordings.inspect.overview_text import overview_lines
from recordings.inspect.story import NodeCycle, story
from recordings.inspect.story_table import NARROWEST, StoryTable, plant_lines
from recordings.read.damage import damage_text
from recordings.read.reader import RunReader
from recordings.read.selection import find_node

_INTERRUPTED: Final = 130


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
    return Console(stderr=to_stderr)


def _width(console: Console) -> int:
    return max(console.width, NARROWEST)


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
    table = StoryTable(run.plan.tree, node, len(run.clock.text(0)), _width(console))
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
    heading, units, *lines = plant_lines(run.plan.tree, found, _width(console))
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
    _print_lines(console, overview_lines(overview, run.clock, _width(console)))
    _warn_if_cut(run, console)
    if json == "-":
        sys.stdout.write(_document(overview).decode())
    elif json is not None:
        Path(json).write_bytes(_document(overview))


def _document(overview: Overview) -> bytes:
    return msgspec.json.format(msgspec.json.encode(overview), indent=1) + b"\n"


def _warn_if_cut(run: RunReader, console: Console) -> None:
    if not run.whole:
        text = (
            f"{run.path} can be read up to byte {run.outline.readable_end:,} of "
            f"{run.outline.size:,}: it was cut, is damaged there, or is still being recorded. "
            "`heliarch recover` makes a whole file of it."
        )
        console.print(Text(text, "yellow"))
