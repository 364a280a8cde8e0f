"""A recording as a new MCAP file: whole, as a recorder closes it, or for Foxglove and Lichtblick.

Viewers get JSON messages with JSON Schemas, which they do not read as a whole. Each property must
have one `type`: a string, a number, an integer, a boolean, an object with `properties`, or an array
whose `items` are one of these. So there are no references here, no tuples and no nulls; what is an
array on the wire to save bytes, such as a line of `help_given`, is an object with named fields.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from importlib.metadata import version
from inspect import getdoc
from math import isfinite
from pathlib import Path
from typing import BinaryIO, Final, Literal, Self, TypeAlias

import msgspec
from mcap.writer import CompressionType, Writer
from msgspec import inspect

from bus_schemas.messages import Message
from bus_schemas.signals import Port, Signal
from recordings.read.reader import RecordedMessage, RunReader
from recordings.read.run_file import RECOVERY_METADATA, recorded_ports
from recordings.record.chunk_writer import ChunkWriter
from recordings.record.writer import declare

JsonObject: TypeAlias = dict[str, object]
Clock: TypeAlias = Literal["wall", "sim"]
"""Which time a viewer shows: the wall clock, or the simulated time of the cycle."""

EXPORT_METADATA: Final = "heliarch export"
"""Name of the metadata of a file for viewers, distinct from that of a recording."""

_LIBRARY: Final = f"heliarch {version('heliarch')}"


class _McapCopy:
    """A copy that is being written; `rows` are the messages of each signal in it.

    Keys, schema names, attachments and sequence numbers are those of the recording.
    """

    def __init__(self, file: BinaryIO, writer: ChunkWriter | Writer, reader: RunReader) -> None:
        self.rows = Counter[str]()
        self.writer = writer
        self.channels: dict[Port[Message], int] = {}
        self._file = file
        for entry in reader.outline.attachments:
            writer.add_attachment(
                entry.create_time, entry.log_time, entry.name, entry.media_type, entry.data
            )

    def add_payload(
        self, record: RecordedMessage, logged_ns: int, published_ns: int, payload: bytes
    ) -> None:
        self.rows[record.port.signal.name] += 1
        channel = self.channels[record.port]
        self.writer.add_message(channel, logged_ns, payload, published_ns, record.sequence)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        with self._file:
            if kind is None:
                self.writer.finish()


class WholeRecording(_McapCopy):
    """All of a recording that can be read, byte for byte, as a recorder would have closed it.

    Metadata named `recovery` says what was damaged: in the copy all checksums are right.
    """

    def __init__(self, path: Path, reader: RunReader) -> None:
        file = path.open("xb")
        super().__init__(file, ChunkWriter(file, "heliarch", _LIBRARY), reader)
        self._reader = reader
        for name, entries in reader.metadata.items():
            self.writer.add_metadata(name, entries)
        self.channels = declare(self.writer, reader.plan, recorded_ports(reader.plan))

    def add(self, record: RecordedMessage, message: Message) -> None:
        self.add_payload(record, record.log_time_ns, record.publish_time_ns, record.payload)

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None:
            outline, losses = self._reader.outline, [self._reader.damage_text()]
            if not outline.closed:
                losses.append(f"cut at byte {outline.readable_end:,}")
            recovery = {
                "recovered_from": self._reader.path.name,
                "damage": "; ".join(filter(None, losses)),
            }
            self.writer.add_metadata(RECOVERY_METADATA, recovery)
        super().__exit__(kind, *error)


class ViewerFile(_McapCopy):
    """A file for viewers."""

    def __init__(
        self, path: Path, reader: RunReader, ports: Iterable[Port[Message]], clock: Clock
    ) -> None:
        file = path.open("xb")
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library=_LIBRARY)
        super().__init__(file, writer, reader)
        self._sim = clock == "sim"
        origin = {
            f"{name}.{key}": value
            for name, entries in reader.metadata.items()
            for key, value in entries.items()
        }
        writer.add_metadata(EXPORT_METADATA, {"clock": clock, **origin})
        in_order = sorted(ports, key=str)
        self.channels = declare(writer, reader.plan, in_order, object_schema, "json")

    def add(self, record: RecordedMessage, message: Message) -> None:
        times_ns = record.log_time_ns, record.publish_time_ns
        if self._sim:
            times_ns = message.sim_time_ns, message.sim_time_ns
        self.add_payload(record, *times_ns, json_bytes(message))


def object_schema(signal: Signal[Message]) -> JsonObject:
    """JSON Schema of a signal's messages as `json_bytes` writes them."""
    return _schema(inspect.type_info(signal.type))


def json_bytes(message: Message) -> bytes:
    """Return a message as a JSON object.

    JSON has neither NaN nor infinity: a field that holds one is left out. No schema requires a
    field that could.
    """
    return msgspec.json.encode(_object(message))


def _object(value: msgspec.Struct) -> JsonObject:
    """Return a struct as a dictionary, those in its lists too, without what JSON cannot say."""
    fields: JsonObject = {}
    for name, entry in msgspec.structs.asdict(value).items():
        if isinstance(entry, tuple) and entry and isinstance(entry[0], msgspec.Struct):
            fields[name] = [_object(item) for item in entry]
        elif entry not in (None, msgspec.UNSET) and _is_finite(entry):
            fields[name] = entry
    return fields


def _is_finite(value: object) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or isfinite(value)


def _schema(kind: inspect.Type) -> JsonObject:
    if isinstance(kind, inspect.UnionType):  # A field that is nil is left out.
        (kind,) = (one for one in kind.types if not isinstance(one, inspect.NoneType))
    match kind:
        case inspect.StructType():
            return _struct_schema(kind)
        case inspect.VarTupleType():
            return {"type": "array", "items": _schema(kind.item_type)}
        case inspect.FloatType():
            return {"type": "number"}
        case inspect.IntType():
            bounds = {"minimum": kind.ge, "exclusiveMaximum": kind.lt}
            given = {name: bound for name, bound in bounds.items() if bound is not None}
            return {"type": "integer", **given}
        case inspect.StrType():
            return {"type": "string"}
        case inspect.LiteralType():
            # Viewers refuse a property without a type, which JSON Schema does not ask for here.
            return {"type": "string", "enum": list(kind.values)}
        case _:
            raise TypeError(f"a field of type {kind} has no form that viewers understand")


def _struct_schema(kind: inspect.StructType) -> JsonObject:
    return {
        "title": kind.cls.__name__,
        "description": getdoc(kind.cls) or "",
        "type": "object",
        "properties": {field.encode_name: _schema(field.type) for field in kind.fields},
        "required": [field.encode_name for field in kind.fields if not _may_be_left_out(field)],
        "additionalProperties": False,
    }


def _may_be_left_out(field: inspect.Field) -> bool:
    kind = field.type.item_type if isinstance(field.type, inspect.VarTupleType) else field.type
    return isinstance(kind, inspect.FloatType | inspect.UnionType)
