"""Where the messages of two recorded runs differ: each signal, each node, each cycle of both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, SIGNALS, Port
from recordings.read.reader import RunReader
from recordings.read.series import RunSeries
from recordings.verify.comparison import BIT_FOR_BIT, FieldDifference
from results.report.style import clock_text
from results.tables import Cell, Column, Number, Table, key_column, word_column

_Digests = dict[Port[Message], NDArray[np.int64]]


@dataclass(frozen=True)
class MessageDifferences:
    """Where two runs differ, and how much of them was compared.

    table: The first difference of each signal.
    messages: How many messages both have together; compared: how many of those were compared.
    is_whole: Whether both recordings are whole and have all cycles of each other.
    """

    table: Table
    messages: int
    compared: int
    is_whole: bool

    @property
    def equal(self) -> bool:
        return not self.table.rows and self.compared == self.messages and self.is_whole

    @property
    def verdict(self) -> str:
        if self.table.rows:
            return "A and B differ"
        part = f"{self.compared:,} of {self.messages:,} messages of both were compared"
        return f"equal bit for bit: {part}" if self.equal else f"equal as far as compared: {part}"


def message_differences(
    paths: tuple[Path, Path], series: Sequence[RunSeries]
) -> MessageDifferences:
    """Compare two runs message by message, in the cycles that both have recorded.

    The times at which messages were decided and sent, and their numbers, are left out, and so is
    `run`, which says when a run began.
    """
    both = np.logical_and(*(one.known for one in series))
    digests, messages, compared, is_whole = [], 0, 0, bool(both.all())
    for path in paths:
        with RunReader(path) as reader:
            found, count = _digests(reader, len(both))
            is_whole = is_whole and reader.whole and not reader.damage_text()
        digests.append(found)
        messages += sum(count.values())
        compared += sum(count[cycle] for cycle in np.flatnonzero(both).tolist() if cycle in count)
    first_of: dict[str, tuple[int, Port[Message]]] = {}
    differ_in: dict[str, NDArray[np.bool_]] = {}
    nothing = np.zeros(len(both), dtype=np.int64)
    for port in dict.fromkeys([*digests[0], *digests[1]]):
        differs = (digests[0].get(port, nothing) != digests[1].get(port, nothing)) & both
        if not differs.any():
            continue
        name, cycle = port.signal.name, int(differs.argmax())
        first_of[name] = min(
            first_of.get(name, (cycle, port)), (cycle, port), key=lambda one: one[0]
        )
        differ_in[name] = differ_in.get(name, np.zeros_like(differs)) | differs
    rows = [
        (cycle, SIGNALS.index(port.signal), row)
        for name, (cycle, port) in first_of.items()
        for row in _rows(paths, series[0], port, cycle, int(differ_in[name].sum()))
    ]
    rows.sort(key=lambda row: row[:2])
    return MessageDifferences(_table(row for _, _, row in rows), messages, compared, is_whole)


def _digests(reader: RunReader, cycles: int) -> tuple[_Digests, dict[int, int]]:
    """Return a digest of what each key had in each cycle, and the messages of each cycle."""
    found: _Digests = {}
    count: dict[int, int] = {}
    for port, message in reader.messages():
        if message.cycle < 0 or port.signal is RUN:
            continue
        count[message.cycle] = count.get(message.cycle, 0) + 1
        if message.cycle < cycles:
            of = found.setdefault(port, np.zeros(cycles, dtype=np.int64))
            # Two processes may have sent one each, in any order.
            of[message.cycle] ^= hash(encode(_timeless(message)))
    return found, count


def _timeless(message: Message) -> Message:
    return replace(message, ready_time_ns=0, publish_time_ns=0, sequence=0)


def _rows(
    paths: tuple[Path, Path], series: RunSeries, port: Port[Message], cycle: int, count: int
) -> Iterator[tuple[Cell, ...]]:
    """Yield the first field in which a message of a cycle differs."""
    sent: list[list[Message]] = []
    for path in paths:
        with RunReader(path) as reader:
            sent.append([message for _, message in reader.on([port], range(cycle, cycle + 1))])
    where = cycle, clock_text(series, cycle)
    if len(sent[0]) != 1 or len(sent[1]) != 1:
        counts = (f"{len(one)} sent" for one in sent)
        yield port.signal.name, port.node or "plant", *where, *counts, count
        return
    one = BIT_FOR_BIT.differences(port, sent[0][0], sent[1][0])[0]
    field, node = _of_inverter(one, port, series)
    a, b = one.recorded, one.new
    yield f"{port.signal.name}, {field}", node, *where, _cell(a, b), _cell(b, a), count


def _of_inverter(one: FieldDifference, port: Port[Message], series: RunSeries) -> tuple[str, str]:
    """Return field and node of a difference: an entry of `inverter_power_kw` is an inverter's."""
    field, _, place = one.field.partition("[")
    if field.startswith("inverter_") and place:
        return field, series.inverters[int(place.rstrip("]"))]
    return one.field, port.node or "plant"


def _cell(value: object, other: object) -> Cell:
    """Return a value with as many decimals as it takes to see that the other one differs."""
    if isinstance(value, float):
        others = other if isinstance(other, float) else value
        differs = (at for at in range(6, 17) if f"{value:.{at}f}" != f"{others:.{at}f}")
        return Number(value, next(differs, 6))
    if isinstance(value, tuple):
        value = ", ".join(map(str, value)) or "none"
    return value if isinstance(value, int) else shorten(str(value), 60, placeholder=" ...")


def _table(rows: Iterator[tuple[Cell, ...]]) -> Table:
    columns = (
        key_column("message"),
        word_column("node"),
        Column("cycle"),
        Column("time"),
        Column("A"),
        Column("B"),
        Column("cycles that differ"),
    )
    found = tuple(rows)
    note = "the first line is where it began" if found else "nowhere, as far as both were compared"
    return Table("Where A and B first differ", columns, found, (note,))
