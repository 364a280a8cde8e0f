"""A recording as an MCAP file for Foxglove and Lichtblick: JSON messages with JSON Schemas.

Foxglove and Lichtblick do not read JSON Schema as a whole. Each property must have one `type`: a
string, a number, an integer, a boolean, an object with `properties`, or an array whose `items` are
one of these. So there are no references here, no tuples and no nulls; what is an array on the wire
to save bytes, such as a line of `help_given`, is an object with named fields.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from importlib.metadata import version
from inspect import getdoc
from math import isfinite
from pathlib import Path
from typing import Final, Literal, TypeAlias

import msgspec
from mcap.writer import CompressionType, Writer
from msgspec import inspect

from bus_schemas.messages import Message
from bus_schemas.signals import Port, Signal
from recordings.read.reader import RecordedMessage, RunReader
from recordings.record.writer import declare

JsonObject: TypeAlias = dict[str, object]
Clock: TypeAlias = Literal["wall", "sim"]
"""Which time a viewer shows: the wall clock, or the simulated time of the cycle."""

EXPORT_METADATA: Final = "heliarch export"
"""Name of the metadata. Not that of a recording, which this file is not."""


class ViewerFile:
    """A file for viewers that is being written; `rows` are the messages of each signal in it.

    Keys, schema names, attachments and sequence numbers are those of the recording.
    """

    def __init__(
        self, path: Path, reader: RunReader, ports: Iterable[Port[Message]], clock: Clock
    ) -> None:
        self.rows = Counter[str]()
        self._sim = clock == "sim"
        self._file = path.open("xb")
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"heliarch {version('heliarch')}")
        self._write_origin(reader, clock)
        in_order = sorted(ports, key=str)
        self._channels = declare(self._writer, reader.plan, in_order, object_schema, "json")

    def add(self, record: RecordedMessage, message: Message) -> None:
        self.rows[record.port.signal.name] += 1
        self._writer.add_message(
            channel_id=self._channels[record.port],
            log_time=message.sim_time_ns if self._sim else record.log_time_ns,
            publish_time=message.sim_time_ns if self._sim else record.publish_time_ns,
            sequence=record.sequence,
            data=json_bytes(message),
        )

    def __enter__(self) -> ViewerFile:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        with self._file:
            if kind is None:
                self._writer.finish()

    def _write_origin(self, reader: RunReader, clock: Clock) -> None:
        for entry in reader.outline.attachments:
            self._writer.add_attachment(
                entry.create_time, entry.log_time, entry.name, entry.media_type, entry.data
            )
        origin = {
            f"{name}.{key}": value
            for name, entries in reader.metadata.items()
            for key, value in entries.items()
        }
        self._writer.add_metadata(EXPORT_METADATA, {"clock": clock, **origin})


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
        elif entry is not None and _is_finite(entry):
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
