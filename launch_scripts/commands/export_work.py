"""`heliarch export`: a recording as a file for viewers, or as tables."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from bus_schemas.errors import InputError
from bus_schemas.signals import SIGNALS
from launch_scripts.commands.termination import leaving_on_sigterm
from launch_scripts.exit_status import BAD_INPUT, FAILED, INTERRUPTED, OK, complain
from launch_scripts.launcher.json_rows import check_json_destination
from recordings.export.exporting import FORMS, ExportSummary, Form, default_path, export
from recordings.export.records import Selection
from recordings.export.unfinished import check_new
from recordings.export.viewer_file import CLOCKS, Clock
from recordings.read.damage import damage_text
from recordings.read.reader import RunReader
from recordings.read.selection import find_nodes, find_signals

RECORDED: Final = tuple(row for row in SIGNALS if row.logged)


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """The words of the command line, None where the user said nothing."""

    run: Path
    to: str
    out: Path | None
    signals: str | None
    nodes: str | None
    start: str | None
    end: str | None
    clock: str | None
    json: str | None


def run_export(request: ExportRequest) -> int:
    """Export what was asked for and say what it came to. Returns the exit status."""
    # With the JSON on standard output, nothing else may go there.
    console = Console(stderr=request.json == "-")
    try:
        summary, damage = _export(request)
    except InputError as error:
        return complain(str(error), BAD_INPUT)
    except OSError as error:
        return complain(f"export: {error}; nothing is left of it", FAILED)
    except KeyboardInterrupt:
        return complain("interrupted; nothing is left of the export", INTERRUPTED)
    _print(summary, console)
    try:
        _write_json(summary, request.json)
    except OSError as error:
        return complain(f"--json: {error}", FAILED)
    if damage:
        sys.stderr.write(f"heliarch: {damage}\n")
    return OK


def _export(request: ExportRequest) -> tuple[ExportSummary, str]:
    """Export; return what it came to, and what of the recording is damaged."""
    form, clock = _form(request.to), _clock(request)
    check_json_destination(request.json)
    with RunReader(request.run, skip_damaged=True) as reader, leaving_on_sigterm():
        path = request.out or default_path(reader.path, form)
        check_new(path)
        selection = _selection(request, reader)
        with _progress(f"{form} {path.name}") as bar:
            task = bar.add_task("", total=1.0)
            summary = export(
                reader,
                form,
                path,
                selection,
                clock,
                lambda share: bar.update(task, completed=share),
            )
        return summary, damage_text(reader)


def _form(text: str) -> Form:
    for form in FORMS:
        if form == text:
            return form
    raise InputError(f"--to {text}: accepted are {', '.join(FORMS)} (the last moment is --until)")


def _clock(request: ExportRequest) -> Clock:
    if request.clock is None:
        return "wall"
    if request.to != "json-mcap":
        raise InputError(f"--clock: accepted with --to json-mcap, this is --to {request.to}")
    for clock in CLOCKS:
        if clock == request.clock:
            return clock
    raise InputError(f"--clock {request.clock}: accepted are {', '.join(CLOCKS)}")


def _selection(request: ExportRequest, reader: RunReader) -> Selection:
    wanted = find_signals(_names(request.signals)) or RECORDED
    signals = tuple(row for row in RECORDED if row in wanted)
    nodes = find_nodes(reader.plan.tree, _names(request.nodes))
    if request.start is None and request.end is None:
        return Selection(signals, nodes)
    return Selection(signals, nodes, reader.clock.span(request.start, request.end))


def _names(text: str | None) -> list[str]:
    return [] if text is None else [name.strip() for name in text.split(",")]


def _progress(title: str) -> Progress:
    console = Console(stderr=True)
    return Progress(
        TextColumn(title, markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def _print(summary: ExportSummary, console: Console) -> None:
    tables = summary.form != "json-mcap"
    table = Table("table" if tables else "signal")
    table.add_column("rows" if tables else "messages", justify="right")
    if tables:
        table.add_column("size", justify="right")
    for part in summary.parts:
        size = [f"{part.size_bytes / 1e6:,.2f} MB"] if tables else []
        table.add_row(part.name, f"{part.rows:,}", *size)
    console.print(table)
    lines = [
        f"{summary.messages:,} messages{_extent(summary)} in {summary.wall_s:.1f} s, "
        f"{summary.size_bytes / 1e6:,.1f} MB"
    ]
    if not summary.whole:
        lines.append("the recording was cut short, or is still written: this is what it holds")
    if summary.left_out:
        lines.append(f"{summary.left_out:,} fields left out: JSON has neither NaN nor infinity")
    lines.append(f"{summary.form}: {summary.path}")
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _extent(summary: ExportSummary) -> str:
    if summary.first_cycle is None:
        return ""
    return f", cycles {summary.first_cycle} to {summary.last_cycle},"


def _write_json(summary: ExportSummary, json: str | None) -> None:
    if json is None:
        return
    document = msgspec.json.format(msgspec.json.encode(summary), indent=1)
    if json == "-":
        sys.stdout.write(document.decode() + "\n")
    else:
        Path(json).write_bytes(document + b"\n")
