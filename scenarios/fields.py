"""What the fields of a scenario take: to check a document, and for the documentation."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, TypeVar, get_args, get_origin

import msgspec
from msgspec import inspect

from bus_schemas.errors import InputError, not_one_of

_T = TypeVar("_T")

_NO_BOUND: Final = 1e12
"""A bound that only keeps infinity out."""


class FieldError(InputError):
    """Fields of a document that do not take what they were given, each with what it takes."""

    def __init__(self, where: str, fields: Sequence[tuple[str, str]]) -> None:
        self.fields = tuple(fields)
        texts = (f"{field}: {text}" if field else text for field, text in fields)
        super().__init__(f"{where}: {'; '.join(texts)}")


def checked(document: object, kind: type[_T], where: str) -> _T:
    """Return a document as a struct, or refuse it with all fields that are wrong."""
    try:
        return msgspec.convert(document, kind, str_keys=True)
    except msgspec.ValidationError:
        raise FieldError(where, list(_wrong(kind, document, ""))) from None


def _wrong(kind: object, value: object, path: str) -> Iterator[tuple[str, str]]:
    """Yield each field at or below a path that does not take its value, and what it takes."""
    try:
        msgspec.convert(value, kind, str_keys=True)
    except msgspec.ValidationError as error:
        found = list(_wrong_inside(kind, value, path))
        types = _of_tag(members(inspect.type_info(kind)), value)
        if not found and isinstance(value, Mapping) and isinstance(types[0], inspect.StructType):
            found = [(path, str(error))]  # From a `__post_init__`, in its own words.
        yield from found or [(path, f"expected {takes(types)}, got {value!r:.60}")]


def _wrong_inside(kind: object, value: object, path: str) -> Iterator[tuple[str, str]]:
    types = _of_tag(members(inspect.type_info(kind)), value)
    if isinstance(value, Mapping):
        tables = [one for one in types if isinstance(one, inspect.StructType)]
        if len(tables) == 1:
            yield from _wrong_in_table(tables[0], value, path)
        elif tables:
            tags = " or ".join(f'"{table.tag}"' for table in tables)
            got = value.get(str(tables[0].tag_field), "nothing")
            yield _join(path, str(tables[0].tag_field)), f"expected {tags}, got {got!r:.60}"
        for _, item_kind in _items_of(kind, dict):
            for name, item in value.items():
                yield from _wrong(item_kind, item, _join(path, str(name)))
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for item_kind, *_ in _items_of(kind, tuple):
            for number, item in enumerate(value):
                yield from _wrong(item_kind, item, f"{path}[{number}]")


def _wrong_in_table(
    table: inspect.StructType, value: Mapping[str, object], path: str
) -> Iterator[tuple[str, str]]:
    tag = () if table.tag_field is None else (table.tag_field,)
    fields = {field.encode_name: field for field in msgspec.structs.fields(table.cls)}
    for name in value:
        if name not in fields and name not in tag:
            yield path, not_one_of((*tag, *fields), name, "the fields ")
    for name, field in fields.items():
        if name in value:
            yield from _wrong(field.type, value[name], _join(path, name))
        elif field.required:
            text = takes(members(inspect.type_info(field.type)))
            yield _join(path, name), f"expected {text}, got nothing"


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
