"""What the fields of a scenario take, read from its structs: for error messages and documents."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import msgspec
from msgspec import inspect

_NO_BOUND: Final = 1e12
"""A bound that only keeps infinity out."""


def readable(error: msgspec.ValidationError, struct: type[Any], document: object) -> str:
    """Say `FIELD: expected X, got Y` of an error in a document that should be a struct."""
    found = re.fullmatch(r"(.*) - at (?:`key` in )?`\$\.?(.*)`", str(error), re.DOTALL)
    what, where = found.groups() if found else (str(error), "")
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", what, re.DOTALL):
        names = _field_names(_types_and_value(struct, where, document)[0])
        text = f"expected the fields {', '.join(names)}, got {unknown[1]}"
    elif missing := re.fullmatch(r"Object missing required field `(.*)`", what):
        where = f"{where}.{missing[1]}".removeprefix(".")
        text = f"expected {takes(_types_and_value(struct, where, document)[0])}, got nothing"
    elif what.startswith(("Expected", "Invalid")):
        types, value = _types_and_value(struct, where, document)
        text = f"expected {takes(types) or what}, got {value!r:.60}"
    else:
        text = what  # From a `__post_init__`, in its own words.
    return f"{where}: {text}" if where else text


def _field_names(tables: Iterable[inspect.Type]) -> tuple[str, ...]:
    names: dict[str, None] = {}
    for table in tables:
        if isinstance(table, inspect.StructType):
            if table.tag_field is not None:
                names[table.tag_field] = None
            names |= dict.fromkeys(field.encode_name for field in table.fields)
    return tuple(names)


def _types_and_value(
    struct: type[Any], path: str, document: object
) -> tuple[list[inspect.Type], object]:
    """Follow a path such as `faults[1].loss`; return the types there but `None`, and the value."""
    types: list[inspect.Type] = [inspect.type_info(struct)]
    for part in re.findall(r"[^.\[\]]+|\[[^\]]*\]", path):
        document = _value_in(document, part)
        types = _meant([one for outer in types for one in _inside(outer, part)], document)
    return types, document


def members(kind: inspect.Type) -> tuple[inspect.Type, ...]:
    """Return the types of a union, or the type itself, without descriptions and `None`."""
    if isinstance(kind, inspect.Metadata):
        return members(kind.type)
    if isinstance(kind, inspect.UnionType):
        return tuple(one for part in kind.types for one in members(part))
    return () if isinstance(kind, inspect.NoneType) else (kind,)


def takes(types: Iterable[inspect.Type]) -> str:
    return " or ".join(dict.fromkeys(_takes(one) for one in types))


def _takes(kind: inspect.Type) -> str:
    match kind:
        case inspect.LiteralType():
            return ", ".join(f'"{value}"' for value in kind.values)
        case inspect.StrType(pattern=str(pattern)):
            return ", ".join(re.findall(r"\^([^$]*)\$", pattern))
        case inspect.VarTupleType(item_type=item):
            return f"list, each: {takes(members(item))}"
        case inspect.TupleType(item_types=items):
            return f"list of {len(items)}, each: {takes(members(items[0]))}"
        case inspect.DictType():
            value = takes(members(kind.value_type))
            return f"table from {takes(members(kind.key_type))} to {value}"
    return _number(kind) if isinstance(kind, _NUMBERS) else _PLAIN[type(kind)]


_NUMBERS: Final = (inspect.IntType, inspect.FloatType)

_PLAIN: Final[dict[type[inspect.Type], str]] = {
    inspect.StructType: "table",
    inspect.StrType: "text",
    inspect.BoolType: "true or false",
    inspect.DateTimeType: "date and time such as 2024-06-15T13:00:00",
    inspect.TimeType: "time of day such as 13:00:00",
}


def _number(kind: inspect.IntType | inspect.FloatType) -> str:
    what = "whole number" if isinstance(kind, inspect.IntType) else "number"
    bounds = (("above", kind.gt), ("from", kind.ge), ("below", kind.lt), ("up to", kind.le))
    said = (f"{word} {bound:.10g}" for word, bound in bounds if bound not in {None, _NO_BOUND})
    return " ".join([what, *said])


def _inside(outer: inspect.Type, part: str) -> Iterator[inspect.Type]:
    """Yield the types that one part of a path leads to; for a tag, its value."""
    match outer:
        case inspect.StructType() if part == outer.tag_field:
            yield inspect.LiteralType((outer.tag,))
        case inspect.StructType():
            for field in outer.fields:
                if field.encode_name == part:
                    yield from members(field.type)
        case inspect.DictType():
            yield from members(outer.value_type)
        case inspect.TupleType():
            yield from members(outer.item_types[0])
        case inspect.CollectionType():
            yield from members(outer.item_type)


def _value_in(document: object, part: str) -> object:
    if isinstance(document, Mapping):
        return document.get(part)
    place = part.strip("[]")
    if isinstance(document, Sequence) and place.isdecimal() and int(place) < len(document):
        return document[int(place)]
    return None


def _meant(types: list[inspect.Type], document: object) -> list[inspect.Type]:
    """Return those types whose tag the document names; all, where it names none."""
    tables = [one for one in types if isinstance(one, inspect.StructType) and one.tag_field]
    if not isinstance(document, Mapping):
        return types
    return [one for one in tables if document.get(one.tag_field) == one.tag] or types
