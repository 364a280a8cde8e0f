"""From a recording to another form: reads it once, and leaves the result whole or not at all."""

# The one optional dependency is imported where it is needed.
# ruff: noqa: PLC0415

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Final, Literal, TypeAlias, get_args

import msgspec

from bus_schemas.errors import InputError
from recordings.export.csv_table import CsvTable
from recordings.export.records import Record, Selection, clock_anchor, records
from recordings.export.table_files import OpenTable, TableFiles
from recordings.export.unfinished import unfinished
from recordings.export.viewer_file import Clock, ViewerFile
from recordings.read.reader import RunReader

Form: TypeAlias = Literal["json-mcap", "parquet", "csv"]
"""A file for viewers of MCAP, or a folder with a file for each table."""

FORMS: Final[tuple[Form, ...]] = get_args(Form)

_ENDING: Final[dict[Form, str]] = {
    "json-mcap": ".json.mcap",
    "parquet": "-parquet",
    "csv": "-csv",
}


class Part(msgspec.Struct, frozen=True):
    """A table of an export, or a signal of one that has no tables.

    Attributes
    ----------
    name
        Of the table or signal.
    rows
        Rows or messages.
    size_bytes
        Of the table's file; 0 where all signals are in one file.
    """

    name: str
    rows: int
    size_bytes: int


class ExportSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What an export came to.

    Attributes
    ----------
    run_id, form, path
        What was exported, into what, and where it is.
    whole
        Whether the recording was whole. Of one that was cut, what is there has been exported.
    first_cycle, last_cycle
        Of the messages that were exported; None if there were none.
    messages
        How many there were.
    left_out
        Fields that hold a NaN or an infinity, which JSON does not have.
    size_bytes
        Of all files.
    wall_s
        Time that it took.
    parts
        By table or signal.
    """

    run_id: str
    form: Form
    path: str
    whole: bool
    first_cycle: int | None
    last_cycle: int | None
    messages: int
    left_out: int
    size_bytes: int
    wall_s: float
    parts: tuple[Part, ...]


def default_path(recording: Path, form: Form) -> Path:
    """Return where an export is put by default: beside its recording, with a name like it."""
    return recording.with_name(f"{recording.stem}{_ENDING[form]}")


def export(
    reader: RunReader,
    form: Form,
    path: Path,
    selection: Selection,
    clock: Clock,
    progress: Callable[[float], None],
) -> ExportSummary:
    """Export a recording.

    Parameters
    ----------
    reader
        The recording.
    form
        What to make of it.
    path
        The file or folder to make; there is none yet.
    selection
        What is wanted of the recording.
    clock
        Times of the messages in a file for viewers.
    progress
        Called now and then with the share that is done, in [0, 1]. What it raises ends the export.

    Raises
    ------
    InputError
        The path is taken, the recording holds what cannot be, or a library is missing.
    """
    began_at = time.monotonic()
    passing = Passing(records(reader, selection, progress))
    left_out = 0
    with unfinished(path) as beside:
        try:
            if form == "json-mcap":
                parts, left_out = _write_viewer_file(beside, reader, selection, clock, passing)
            else:
                parts = _write_tables(beside, reader, selection, form, passing)
        except InputError as error:
            raise InputError(f"{reader.path}: {error}") from None
    return ExportSummary(
        run_id=reader.plan.run_id,
        form=form,
        path=str(path),
        whole=reader.whole,
        first_cycle=passing.first_cycle,
        last_cycle=passing.last_cycle,
        messages=passing.counts.total(),
        left_out=left_out,
        size_bytes=sum(part.size_bytes for part in parts) or path.stat().st_size,
        wall_s=time.monotonic() - began_at,
        parts=parts,
    )


class Passing:
    """Records on their way, counted.

    Attributes
    ----------
    counts
        Messages so far, by the name of their signal.
    first_cycle, last_cycle
        The smallest and the largest so far.
    """

    def __init__(self, source: Iterable[Record]) -> None:
        self.counts: Counter[str] = Counter()
        self.first_cycle: int | None = None
        self.last_cycle: int | None = None
        self._source = source

    def __iter__(self) -> Iterator[Record]:
        for record in self._source:
            cycle = record.message.cycle
            if self.first_cycle is None or self.last_cycle is None:
                self.first_cycle = self.last_cycle = cycle
            elif cycle > self.last_cycle:
                self.last_cycle = cycle
            elif cycle < self.first_cycle:
                self.first_cycle = cycle
            self.counts[record.port.signal.name] += 1
            yield record


def _write_viewer_file(
    path: Path, reader: RunReader, selection: Selection, clock: Clock, passing: Passing
) -> tuple[tuple[Part, ...], int]:
    """Write the file for viewers; return its signals, and how many fields JSON could not hold."""
    with ViewerFile(path, reader, selection.signals, clock) as file:
        for record in passing:
            file.add(record)
    parts = tuple(Part(signal.name, passing.counts[signal.name], 0) for signal in selection.signals)
    return parts, file.left_out


def _write_tables(
    folder: Path, reader: RunReader, selection: Selection, form: Form, passing: Passing
) -> tuple[Part, ...]:
    """Write the folder of tables; return them."""
    suffix = f".{form}"
    with TableFiles(
        folder, reader.plan, selection.signals, clock_anchor(reader), _table_file(form), suffix
    ) as files:
        for record in passing:
            files.add(record)
    return tuple(
        Part(name, rows, (folder / f"{name}{suffix}").stat().st_size)
        for name, rows in files.rows.items()
    )


def _table_file(form: Form) -> OpenTable:
    if form == "csv":
        return CsvTable
    try:
        from recordings.export.parquet_table import ParquetTable
    except ModuleNotFoundError:
        raise InputError(
            "--to parquet needs pyarrow, which is not installed: pip install 'heliarch[parquet]', "
            "or take --to csv"
        ) from None
    return ParquetTable
