"""Messages as JSON objects, with schemas that viewers of MCAP files understand.

Foxglove and Lichtblick do not read JSON Schema as a whole. Each property must have one `type`: a
string, a number, an integer, a boolean, an object with `properties`, or an array whose `items` are
one of these. So there are no references here, no tuples and no nulls; what is an array on the wire
to save bytes, such as a line of `help_given`, is an object with named fields.
"""

from __future__ import annotations

from inspect import getdoc
from math import isfinite
from typing import Final, TypeAlias

import msgspec
from msgspec import inspect

from bus_schemas.messages import Message
from bus_schemas.signals import Signal

JsonObject: TypeAlias = dict[str, object]

_NULL: Final = b"null"
"""What msgspec writes for a number that JSON does not have."""


def object_schema(signal: Signal[Message]) -> JsonObject:
    """JSON Schema of a signal's messages as `JsonEncoder` writes them."""
    return _schema(inspect.type_info(signal.type))


class JsonEncoder:
    """Writes messages as JSON.

    JSON has neither NaN nor infinity: a field that holds one is left out, and counted. No schema
    requires a field that could.
    """

    def __init__(self) -> None:
        self.left_out = 0
        self._encoder = msgspec.json.Encoder()

    def encode(self, message: Message) -> bytes:
        """Return a message as a JSON object."""
        fields = _plain(message)
        text = self._encoder.encode(fields)
        if _NULL in text:  # Or the word stands in a text: then nothing is left out.
            text = self._encoder.encode(self._finite(fields))
        return text

    def _finite(self, fields: JsonObject) -> JsonObject:
        kept: JsonObject = {}
        for name, value in fields.items():
            if isinstance(value, list):
                kept[name] = [self._finite(item) for item in value]
            elif _all_finite(value):
                kept[name] = value
            else:
                self.left_out += 1
        return kept


def _plain(value: msgspec.Struct) -> JsonObject:
    """Return a struct as a dictionary, those inside it in lists too, without what is nil."""
    found: JsonObject = {}
    for name, entry in msgspec.structs.asdict(value).items():
        if isinstance(entry, tuple) and entry and isinstance(entry[0], msgspec.Struct):
            found[name] = [_plain(item) for item in entry]
        elif entry is not None:
            found[name] = entry
    return found


def _all_finite(value: object) -> bool:
    if isinstance(value, tuple):
        return all(map(_all_finite, value))
    return not isinstance(value, float) or isfinite(value)


def _schema(kind: inspect.Type) -> JsonObject:
    kind = not_nil(kind)
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


def not_nil(kind: inspect.Type) -> inspect.Type:
    """Return the type of a field when it is there: one that is nil is left out."""
    if not isinstance(kind, inspect.UnionType):
        return kind
    (found,) = (member for member in kind.types if not isinstance(member, inspect.NoneType))
    return found
