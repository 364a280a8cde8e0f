"""`heliarch export`: a recording as a file for viewers, or as tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from bus_schemas.errors import InputError
from launch_scripts.commands.boundary import OK, complain
from launch_scripts.commands.output import progress_bar, say, write_json
from studies.tables import Column, Table, console_for, key_column, print_table

if TYPE_CHECKING:
    from rich.console import Console

    from recordings.export.exporting import ExportSummary


def export(
    run: Path,
    form: Literal["json-mcap", "parquet", "csv"],
    start: str | None = None,
    end: str | None = None,
    nodes: str | None = None,
    signals: str | None = None,
    clock: Literal["wall", "sim"] | None = None,
    out: Path | None = None,
    json: str | None = None,
) -> int:
    """Make a file for viewers, or tidy tables, from a recording.

    --format (form): json-mcap is for Foxglove and Lichtblick.
    --clock: Times in json-mcap: wall, as recorded (the default), or sim, simulated time.
    --out PATH: The new file, or folder of tables; default beside the recording.
    Example: heliarch export runs/oahu-20261121-120000-4711 --format csv --nodes c1/*
    """
    from bus_schemas.signals import SIGNALS
    from recordings.export.exporting import default_path
    from recordings.export.exporting import export as export_run
    from recordings.read.reader import RunReader
    from recordings.read.selection import find_signals
    from recordings.read.whole_file import check_new

    if clock is not None and form != "json-mcap":
        raise InputError(f"--clock: expected --format json-mcap with it, got {form}")
    with RunReader(run, skip_damaged=True) as reader:
        path = out or default_path(reader.path, form)
        check_new(path)
        wanted = find_signals(signals or "")
        rows = tuple(row for row in SIGNALS if row.logged and (not wanted or row in wanted))
        cycles = None if start is None and end is None else reader.clock.span(start, end)
        with progress_bar(form) as reader.follow:
            summary = export_run(reader, form, path, rows, nodes or "", cycles, clock or "wall")
        damage = reader.damage_text()
    _print(summary, console_for(json))
    write_json(summary, json)
    return complain(damage, OK) if damage else OK


def _print(summary: ExportSummary, console: Console) -> None:
    columns = key_column("signal or table"), Column("rows")
    cut = "the recording was cut short, or is still written: this is what it holds"
    title = f"{summary.messages:,} messages"
    if summary.first_cycle is not None:
        title += f", cycles {summary.first_cycle:,} to {summary.last_cycle:,}"
    notes = () if summary.whole else (cut,)
    print_table(console, Table(title, columns, tuple(summary.rows.items()), notes))
    say(console, f"{summary.form}: {summary.path}")
