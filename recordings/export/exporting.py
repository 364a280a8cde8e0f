"""From a recording to another format: reads it once, and leaves a whole result or none."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from math import ceil
from pathlib import Path
from typing import Final, Literal, TypeAlias

import msgspec

from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import SIGNALS, Port, Signal
from bus_schemas.whole_file import check_new, new_path, whole_file
from recordings.export.comtrade import write_comtrade
from recordings.export.foxglove import layout, layout_path
from recordings.export.mcap_copies import Clock, ViewerFile, WholeRecording
from recordings.export.tables import TableFolder
from recordings.read.reader import RunReader
from recordings.record.writer import ClockAnchor
from scenarios.times import When

Form: TypeAlias = Literal["mcap", "json-mcap", "parquet", "csv", "comtrade"]
"""The recording itself as one whole file, a file for viewers of MCAP, a folder of tables, or the
two files of a COMTRADE record in a folder."""

WINDOW_S: Final = 60.0
"""Before and after its trigger a COMTRADE record shows as much [s]."""

_ENDING: Final[dict[Form, str]] = {
    "mcap": ".recovered.mcap",
    "json-mcap": ".json.mcap",
    "parquet": "-parquet",
    "csv": "-csv",
    "comtrade": "-comtrade",
}


class ExportSummary(msgspec.Struct, frozen=True, kw_only=True):
    """The result of an export.

    rows: Those of each table, the messages of each signal, or the samples of each channel.
    """

    run_id: str
    form: Form
    path: str
    whole: bool
    first_cycle: int | None
    last_cycle: int | None
    messages: int
    rows: dict[str, int]


def default_path(recording: Path, form: Form) -> Path:
    return recording.with_name(f"{recording.stem}{_ENDING[form]}")


def export(
    reader: RunReader,
    form: Form,
    path: Path | None = None,
    signals: Sequence[Signal[Message]] = (),
    nodes: str | Collection[str] = (),
    cycles: range | None = None,
    clock: Clock | None = None,
    at: When | None = None,
    window_s: float | None = None,
) -> ExportSummary:
    """Export some signals, nodes and cycles of a recording; omitted means all.

    The new file, or folder, is by default beside the recording. `at` and `window_s` are the
    trigger of a COMTRADE record, and the time that it shows before and after it.
    """
    if (form == "comtrade") != (at is not None) or (at is None and window_s is not None):
        raise InputError.of("--at, --window", f"expected --format comtrade --at TIME, got {form}")
    if at is not None and (signals or nodes or cycles):
        raise InputError("--signals, --nodes, --from, --to: expected --window with comtrade")
    if clock is not None and form != "json-mcap":
        raise InputError.of("--clock", f"expected --format json-mcap with it, got {form}")
    if form == "mcap" and (signals or nodes or cycles):
        options = "--signals, --nodes, --from, --to"
        raise InputError(f"{options}: expected another --format, since mcap is the whole recording")
    path = path or default_path(reader.path, form)
    for new in (path, layout_path(path)) if form == "json-mcap" else (path,):
        check_new(new)
    signals = [one for one in SIGNALS if one.logged and (not signals or one in signals)]
    ports = reader.ports(*signals, nodes=nodes)
    rows, messages = {signal.name: 0 for signal in signals}, 0
    with new_path(path) as beside:
        if at is not None:
            cycle = reader.clock.cycle(at, "--at")
            around = ceil((WINDOW_S if window_s is None else window_s) / reader.plan.timing.cycle_s)
            span = range(max(cycle - around, 0), min(cycle + around, reader.last_cycle) + 1)
            rows = dict.fromkeys(write_comtrade(reader, beside, cycle, span), len(span))
        else:
            with _opened(form, beside, reader, signals, ports, clock) as out:
                span, messages = _add_all(out, reader, ports, cycles)
            rows |= out.rows
    if form == "json-mcap":
        with whole_file(layout_path(path)) as file:
            file.write(msgspec.json.encode(layout(reader.plan, ports)))
    return ExportSummary(
        run_id=reader.plan.run_id,
        form=form,
        path=str(path),
        whole=reader.whole,
        first_cycle=span.start if span else None,
        last_cycle=span.stop - 1 if span else None,
        messages=messages,
        rows=rows,
    )


def _opened(
    form: Form,
    path: Path,
    reader: RunReader,
    signals: Sequence[Signal[Message]],
    ports: Collection[Port[Message]],
    clock: Clock | None,
) -> WholeRecording | ViewerFile | TableFolder:
    match form:
        case "mcap":
            return WholeRecording(path, reader)
        case "json-mcap":
            usual: Clock = "sim" if reader.plan.timing.lockstep else "wall"
            return ViewerFile(path, reader, ports, clock or usual)
        case "parquet" | "csv":
            anchor = ClockAnchor.of(reader.metadata, reader.path)
            return TableFolder(path, reader.plan, signals, anchor, form)
        case "comtrade":
            raise InputError.of("--format", "expected --at with comtrade")


def _add_all(
    out: WholeRecording | ViewerFile | TableFolder,
    reader: RunReader,
    ports: Collection[Port[Message]],
    cycles: range | None,
) -> tuple[range, int]:
    """Add all messages on some ports; return the cycles that they are of, and their number."""
    first, end, messages = 1 << 62, 0, 0
    for record in reader.records(ports, cycles):
        message = reader.decoded(record)
        if message is None:
            continue
        try:
            out.add(record, message)
        except InputError as error:  # Of another plant: wrong as well.
            reader.wrong.setdefault(record.port, str(error))
            continue
        messages += 1
        if record.port.signal.is_cyclic:  # The end of a run names the cycle after it.
            first, end = min(first, record.cycle), max(end, record.cycle + 1)
    return range(first, end), messages
