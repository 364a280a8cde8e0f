"""What the fields of a scenario take, read from its structs: for error messages and documents."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import msgspec
from msgspec import inspect

_LONGEST_SHOWN: Final = 60
_NO_BOUND: Final = 1e12
"""A bound that only keeps infinity out."""


def readable(error: msgspec.ValidationError, struct: type[Any], document: object) -> str:
    """Say `FIELD: expected X, got Y` of an error in a document that should be a struct."""
    where, what = place_and_objection(error)
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", what, re.DOTALL):
        names = ", ".join(field_names(struct, where, document))
        return _at(where, f"expected the fields {names}, got {unknown[1]}")
    if missing := re.fullmatch(r"Object missing required field `(.*)`", what):
        place = f"{where}.{missing[1]}" if where else missing[1]
        return _at(place, f"expected {_needs(struct, place, document)}, got nothing")
    if not what.startswith(("Expected", "Invalid")):
        return _at(where, what)  # From a `__post_init__`, in its own words.
    types, value = types_at(struct, where, document), _value_at(document, where)
    if " in `$" in str(error) and isinstance(value, Mapping):
        types, value = [key for one in types for key in _keys(one)], ", ".join(map(str, value))
    return _at(where, f"expected {takes(types) or what}, got {_shown(value)}")


def place_and_objection(error: msgspec.ValidationError) -> tuple[str, str]:
    """Return where in a document an error of msgspec lies, such as `a.b`, and what it is."""
    found = re.fullmatch(r"(.*) - at (?:`key` in )?`\$\.?(.*)`", str(error), re.DOTALL)
    return (found[2], found[1]) if found else ("", str(error))


def field_names(struct: type[Any], path: str, document: object = None) -> tuple[str, ...]:
    """Return the names of the fields of a table, as a file writes them.

    Where several structs can stand, the document says which is meant; if it does not, the fields of
    all of them are named.
    """
    names: dict[str, None] = {}
    for table in types_at(struct, path, document):
        if isinstance(table, inspect.StructType):
            if table.tag_field is not None:
                names[table.tag_field] = None
            names |= dict.fromkeys(field.encode_name for field in table.fields)
    return tuple(names)


def types_at(struct: type[Any], path: str, document: object = None) -> list[inspect.Type]:
    """Return the types that a path such as `faults[1].loss` leads to, without those of `None`."""
    found: list[inspect.Type] = [inspect.type_info(struct)]
    for part in re.findall(r"[^.\[\]]+|\[[^\]]*\]", path):
        document = _value_in(document, part)
        inner = [one for outer in found for one in _inside(outer, part)]
        found = _meant(inner, document)
    return found


def members(kind: inspect.Type) -> tuple[inspect.Type, ...]:
    """Return the types of a union, or the type itself, without descriptions and `None`."""
    if isinstance(kind, inspect.Metadata):
        return members(kind.type)
    if isinstance(kind, inspect.UnionType):
        return tuple(one for part in kind.types for one in members(part))
    return () if isinstance(kind, inspect.NoneType) else (kind,)


def takes(types: Iterable[inspect.Type]) -> str:
    return " or ".join(dict.fromkeys(_takes(one) for one in types))


def _needs(struct: type[Any], place: str, document: object) -> str:
    """Say in words what a field takes that is missing; of a table also its required fields."""
    types = types_at(struct, place, document)
    tables = [one for one in types if isinstance(one, inspect.StructType)]
    names = [field.encode_name for table in tables[:1] for field in table.fields if field.required]
    if tables and tables[0].tag_field is not None:
        names = [tables[0].tag_field]
    fields = (f"{one} ({takes(types_at(struct, f'{place}.{one}', document))})" for one in names)
    return " with ".join(filter(None, [takes(types), ", ".join(fields)]))


def _takes(kind: inspect.Type) -> str:
    match kind:
        case inspect.LiteralType():
            return ", ".join(f'"{value}"' for value in kind.values)
        case inspect.IntType() | inspect.FloatType():
            return _number(kind)
        case inspect.StrType(pattern=str(pattern)):
            return ", ".join(re.findall(r"\^([^$]*)\$", pattern))
    return _takes_several(kind) or _PLAIN[type(kind)]


def _takes_several(kind: inspect.Type) -> str:
    match kind:
        case inspect.VarTupleType():
            return f"list, each: {takes(members(kind.item_type))}"
        case inspect.TupleType():
            return f"list of {len(kind.item_types)}, each: {takes(members(kind.item_types[0]))}"
        case inspect.DictType():
            value = takes(members(kind.value_type))
            return f"table from {takes(members(kind.key_type))} to {value}"
    return ""


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


def _at(where: str, text: str) -> str:
    return f"{where}: {text}" if where else text


def _shown(value: object) -> str:
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def _keys(kind: inspect.Type) -> tuple[inspect.Type, ...]:
    return members(kind.key_type) if isinstance(kind, inspect.DictType) else ()


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


def _value_at(document: object, path: str) -> object:
    for part in re.findall(r"[^.\[\]]+|\[\d+\]", path):
        document = _value_in(document, part)
    return document


def _value_in(document: object, part: str) -> object:
    if isinstance(document, Mapping):
        return document.get(part)
    place = part.strip("[]")
    if isinstance(document, Sequence) and place.isdecimal() and int(place) < len(document):
        return document[int(place)]
    return None


def _meant(types: list[inspect.Type], document: object) -> list[inspect.Type]:
    """Return those types whose tag the document names; all, where it names none."""
    named: list[inspect.Type] = [
        one
        for one in types
        if isinstance(one, inspect.StructType)
        and one.tag_field is not None
        and isinstance(document, Mapping)
        and document.get(one.tag_field) == one.tag
    ]
    return named or types
