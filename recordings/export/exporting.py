"""From a recording to another format: reads it once, and leaves a whole result or none."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TypeAlias, get_args

import msgspec

from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Signal
from recordings.export.tables import TableFolder
from recordings.export.viewer_file import Clock, ViewerFile
from recordings.read.reader import RunReader
from recordings.read.whole_file import new_path
from recordings.record.writer import ClockAnchor

Form: TypeAlias = Literal["json-mcap", "parquet", "csv"]
"""A file for viewers of MCAP, or a folder with a file for each table."""

FORMS: Final[tuple[Form, ...]] = get_args(Form)

_ENDING: Final[dict[Form, str]] = {
    "json-mcap": ".json.mcap",
    "parquet": "-parquet",
    "csv": "-csv",
}
_FOLLOW_EVERY: Final = 4096
"""Messages between two calls of `progress`."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The part of a recording that is wanted: no nodes or cycles given means all."""

    signals: tuple[Signal[Message], ...]
    nodes: tuple[str, ...] = ()
    cycles: range | None = None


class Part(msgspec.Struct, frozen=True):
    """A table, or a signal in a file for viewers: its rows or messages, and its file's size."""

    name: str
    rows: int
    size_bytes: int


class ExportSummary(msgspec.Struct, frozen=True, kw_only=True):
    """The result of an export; `left_out` fields are NaN or infinite, which JSON does not have."""

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
    """Return where an export is put by default: beside its recording, with a similar name."""
    return recording.with_name(f"{recording.stem}{_ENDING[form]}")


def export(
    reader: RunReader,
    form: Form,
    path: Path,
    selection: Selection,
    clock: Clock,
    progress: Callable[[float], None],
) -> ExportSummary:
    """Export a recording."""
    began_at = time.monotonic()
    counts: Counter[str] = Counter()
    cycles: set[int] = set()
    ports = reader.ports(*selection.signals, nodes=selection.nodes)
    with new_path(path) as beside:
        out = _open(reader, form, beside, selection, clock)
        try:
            with out:
                for number, record in enumerate(reader.records(ports, selection.cycles)):
                    if number % _FOLLOW_EVERY == 0:
                        progress(reader.read_share)
                    out.add(record, record.message())
                    counts[record.port.signal.name] += 1
                    if record.port.signal.is_cyclic:  # The end of a run names the cycle after it.
                        cycles.add(record.cycle)
        except InputError as error:
            raise InputError(f"{reader.path}: {error}") from None
        parts = _parts(out, selection, counts)
    progress(1.0)
    return ExportSummary(
        run_id=reader.plan.run_id,
        form=form,
        path=str(path),
        whole=reader.whole,
        first_cycle=min(cycles, default=None),
        last_cycle=max(cycles, default=None),
        messages=counts.total(),
        left_out=out.left_out if isinstance(out, ViewerFile) else 0,
        size_bytes=sum(part.size_bytes for part in parts) or path.stat().st_size,
        wall_s=time.monotonic() - began_at,
        parts=parts,
    )


def _open(
    reader: RunReader, form: Form, path: Path, selection: Selection, clock: Clock
) -> ViewerFile | TableFolder:
    if form == "json-mcap":
        return ViewerFile(path, reader, selection.signals, clock)
    anchor = ClockAnchor.of(reader.metadata)
    return TableFolder(path, reader.plan, selection.signals, anchor, form)


def _parts(
    out: ViewerFile | TableFolder, selection: Selection, counts: Counter[str]
) -> tuple[Part, ...]:
    if isinstance(out, ViewerFile):
        return tuple(Part(signal.name, counts[signal.name], 0) for signal in selection.signals)
    return tuple(
        Part(name, file.rows, file.path.stat().st_size) for name, file in out.files.items()
    )
