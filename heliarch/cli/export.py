"""`heliarch export`: a recording as one whole file, as a file for viewers, or as tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from bus_schemas.selection import find_signals
from heliarch.cli.options import FILES, End, Json, Nodes, Run, Signals, Start
from heliarch.cli.output import Output, progress_bar
from results.tables import Column, Table, key_column


def export(
    run: Run,
    /,
    *,
    form: Annotated[
        Literal["mcap", "json-mcap", "parquet", "csv", "comtrade"], Parameter("--format")
    ],
    start: Start = None,
    end: End = None,
    nodes: Nodes = None,
    signals: Signals = None,
    clock: Literal["wall", "sim"] | None = None,
    at: Annotated[str | None, Parameter(metavar="TIME")] = None,
    window: Annotated[str | None, Parameter(metavar="TIME")] = None,
    out: Annotated[Path | None, Parameter(group=FILES)] = None,
    json: Json = None,
) -> None:
    """Make tables, or a file for viewers, of a recording.

    Or one whole file of a cut or damaged recording.

    Example: `heliarch export runs/oahu-20261121-120000-4711 --format csv --nodes c1/*`

    Parameters
    ----------
    form
        mcap is all of the recording that can be read; json-mcap is for Foxglove and Lichtblick;
        comtrade is for viewers of relay records.
    clock
        Times in json-mcap: wall, as recorded, or sim, simulated time: the default in lockstep.
    at
        Trigger of the COMTRADE record: the cycle in which an event began.
    window
        Time that the COMTRADE record shows before and after it; default 1m.
    out
        The new file, or folder; default beside the recording.
    """
    from recordings.export.exporting import export as export_run
    from recordings.export.foxglove import layout_path
    from recordings.read.reader import RunReader
    from scenarios.times import parse_duration_s

    window_s = None if window is None else parse_duration_s(window, "--window")
    wanted, output = find_signals(signals or ""), Output(json)
    with RunReader(run) as reader:
        cycles = None if start is None and end is None else reader.clock.span(start, end)
        with progress_bar(form) as reader.follow:
            parts = wanted, nodes or "", cycles, clock, at, window_s
            summary = export_run(reader, form, out, *parts)
    title = "A COMTRADE record" if form == "comtrade" else f"{summary.messages:,} messages"
    if summary.first_cycle is not None:
        title += f", cycles {summary.first_cycle:,} to {summary.last_cycle:,}"
    cut = "the recording was cut short, or is still written: this is what it holds"
    columns = key_column("signal, table or channel"), Column("rows")
    notes = () if summary.whole else (cut,)
    output.show(Table(title, columns, tuple(summary.rows.items()), notes))
    output.say(f"{summary.form}: {summary.path}")
    if form == "json-mcap":
        output.say(f"layout for Foxglove: {layout_path(Path(summary.path))}")
    output.write(summary)
