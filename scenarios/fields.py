"""What the fields of a scenario take: to check a document, and for the documentation."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, TypeVar, get_args, get_origin

import msgspec
from msgspec import inspect

from bus_schemas.errors import InputError, not_one_of

_T = TypeVar("_T")

_NO_BOUND: Final = 1e12
"""A bound that only keeps infinity out."""

_HEADING: Final = re.compile(r"\s*(\[\[?)\s*([\w.-]+)\s*\]+\s*(#.*)?$")
_ENTRY: Final = re.compile(r"\s*([\w.-]+)\s*=")
_LAST_PART: Final = re.compile(r"(\.?[^.\[]+|\[\d+\])$")


def checked(document: object, kind: type[_T], where: str, text: str = "") -> _T:
    """Return a document as a struct, or refuse it with all fields that are wrong.

    `text` is the TOML that the document was read from: each field is named with its line there.
    """
    try:
        return msgspec.convert(document, kind, str_keys=True)
    except msgspec.ValidationError:
        complaints = (with_line(one, text) for one in _wrong(kind, document, ""))
        raise InputError(f"{where}: {'; '.join(complaints)}") from None


def with_line(complaint: str, text: str) -> str:
    """Put before a complaint, `FIELD: ...`, in which line of a TOML text the field stands."""
    lines, field = _field_lines(text), complaint.partition(": ")[0]
    while field and field not in lines:
        field = _LAST_PART.sub("", field)  # Of a field that is missing, its table.
    return f"line {lines[field]}: {complaint}" if field else complaint


def _field_lines(text: str) -> dict[str, int]:
    found: dict[str, int] = {}
    tables = Counter[str]()
    prefix = ""
    for number, line in enumerate(text.splitlines(), 1):
        if heading := _HEADING.match(line):
            table = heading[2]
            if heading[1] == "[[":
                table = f"{table}[{tables[table]}]"
                tables[heading[2]] += 1
            prefix = f"{table}."
            found.setdefault(table, number)
        elif entry := _ENTRY.match(line):
            found.setdefault(prefix + entry[1], number)
    return found


def _wrong(kind: object, value: object, path: str) -> Iterator[str]:
    """Yield a complaint for each field at or below a path that does not take its value."""
    try:
        msgspec.convert(value, kind, str_keys=True)
    except msgspec.ValidationError as error:
        found = list(_wrong_inside(kind, value, path))
        types = _of_tag(members(inspect.type_info(kind)), value)
        if not found and isinstance(value, Mapping) and isinstance(types[0], inspect.StructType):
            # From a `__post_init__`, in its own words: about the table, or one of its fields.
            of_table = str(error).startswith("expected")
            found = [f"{path}: {error}" if of_table else _join(path, str(error))]
        yield from found or [f"{path}: expected {takes(types)}, got {value!r:.60}"]


def _wrong_inside(kind: object, value: object, path: str) -> Iterator[str]:
    types = _of_tag(members(inspect.type_info(kind)), value)
    if isinstance(value, Mapping):
        tables = [one for one in types if isinstance(one, inspect.StructType)]
        if len(tables) == 1:
            yield from _wrong_in_table(tables[0], value, path)
        elif tables:
            tags = " or ".join(f'"{table.tag}"' for table in tables)
            tag_field = str(tables[0].tag_field)
            got = value.get(tag_field, "nothing")
            yield f"{_join(path, tag_field)}: expected {tags}, got {got!r:.60}"
        for _, item_kind in _items_of(kind, dict):
            for name, item in value.items():
                yield from _wrong(item_kind, item, _join(path, str(name)))
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for item_kind, *_ in _items_of(kind, tuple):
            for number, item in enumerate(value):
                yield from _wrong(item_kind, item, f"{path}[{number}]")


def _wrong_in_table(
    table: inspect.StructType, value: Mapping[str, object], path: str
) -> Iterator[str]:
    tag = () if table.tag_field is None else (table.tag_field,)
    fields = {field.encode_name: field for field in msgspec.structs.fields(table.cls)}
    for name in value:
        if name not in fields and name not in tag:
            yield f"{_join(path, name)}: {not_one_of((*tag, *fields), name, 'the fields ')}"
    for name, field in fields.items():
        if name in value:
            yield from _wrong(field.type, value[name], _join(path, name))
        elif field.required:
            text = takes(members(inspect.type_info(field.type)))
            yield f"{_join(path, name)}: expected {text}, got nothing"


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _items_of(kind: object, container: type) -> Iterator[tuple[object, ...]]:
    """Yield the types of the items of a container, also where it is one member of a union."""
    if get_origin(kind) is container:
        yield get_args(kind)
    elif get_origin(kind) is not dict:
        for part in get_args(kind):
            yield from _items_of(part, container)


def _of_tag(types: Sequence[inspect.Type], value: object) -> Sequence[inspect.Type]:
    """Return those types whose tag the document names; all, where it names none."""
    if not isinstance(value, Mapping):
        return types
    tables = [one for one in types if isinstance(one, inspect.StructType) and one.tag_field]
    return [one for one in tables if value.get(one.tag_field) == one.tag] or types


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
            return pattern.strip("^$").replace("$|^", ", ")
        case inspect.VarTupleType(item_type=item):
            return f"list, each: {takes(members(item))}"
        case inspect.TupleType(item_types=items):
            return f"list of {len(items)}, each: {takes(members(items[0]))}"
        case inspect.DictType():
            value = takes(members(kind.value_type))
            return f"table from {takes(members(kind.key_type))} to {value}"
    numbers = (inspect.IntType, inspect.FloatType)
    return _number(kind) if isinstance(kind, numbers) else _PLAIN[type(kind)]


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
