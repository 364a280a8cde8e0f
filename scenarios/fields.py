"""What the fields of a scenario take: to check a document, and for the documentation."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any, Final, TypeVar, cast

import msgspec
from msgspec import inspect

from bus_schemas.errors import InputError, not_one_of

_T = TypeVar("_T")

_NO_BOUND: Final = 1e12
"""A bound that only keeps infinity out."""

_HEADING: Final = re.compile(r"\s*(\[\[?)\s*([\w.-]+)\s*\]+\s*(#.*)?$")
_ENTRY: Final = re.compile(r"\s*([\w.-]+)\s*=")
_PATH: Final = re.compile(r"`\$([^`]*?)(?:\[\.\.\.\].*)?`$")
_PART: Final = re.compile(r"\.[^.\[]+|\[\d+\]")


def checked(document: object, kind: type[_T], where: str = "", text: str = "") -> _T:
    """Return a document as a struct, or refuse it with the first field that is wrong.

    `text` is the TOML that the document was read from, which says in which line the field stands.
    """
    try:
        return msgspec.convert(document, kind, str_keys=True)
    except msgspec.ValidationError as error:
        wrong = _refusal(error, kind, document)
        raise wrong.within(line_of(wrong.field, text)).within(where) from None


def line_of(field: str, text: str) -> str:
    """Say in which line of a TOML text a field stands, or the table that lacks it."""
    lines = _field_lines(text)
    while field and field not in lines:
        field = field[: max(field.rfind("."), field.rfind("["), 0)]
    return f"line {lines[field]}" if field else ""


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


def _refusal(error: msgspec.ValidationError, kind: type, document: object) -> InputError:
    """Name the field that msgspec's path leads to, what it takes and what stands there."""
    path = _PATH.search(str(error))
    types, field, value = members(inspect.type_info(kind)), "", cast(Any, document)
    for part in _PART.findall(path[1] if path else ""):
        step = int(part[1:-1]) if part[0] == "[" else part.lstrip(".")
        if any(getattr(one, "tag_field", None) == step for one in types):
            break  # The kind of the table is not known.
        types = _types_inside(_of_tag(types, value), step)
        value, field = value[step], (field + part).lstrip(".")
    types = _of_tag(types, value)
    tables = [one for one in types if isinstance(one, inspect.StructType)]
    if isinstance(value, Mapping) and len(tables) == 1:
        return _table_refusal(error, tables[0], value, field)
    if isinstance(value, Mapping) and tables:
        tag = str(tables[0].tag_field)
        expected = " or ".join(f'"{table.tag}"' for table in tables)
        got = value.get(tag, "nothing")
        return InputError.of(_join(field, tag), f"expected {expected}, got {got!r:.60}")
    return InputError.of(field, f"expected {takes(types)}, got {value!r:.60}")


def _table_refusal(
    error: msgspec.ValidationError,
    table: inspect.StructType,
    value: Mapping[str, object],
    path: str,
) -> InputError:
    fields = {field.encode_name: field for field in table.fields}
    known = [*([table.tag_field] if table.tag_field else []), *fields]
    for name in value:
        if name not in known:
            return InputError.of(_join(path, name), not_one_of(known, name, "the fields "))
    for name, field in fields.items():
        if field.required and name not in value:
            expected = takes(members(field.type))
            return InputError.of(_join(path, name), f"expected {expected}, got nothing")
    cause = error.__cause__  # From a `__post_init__`, about the table or one of its fields.
    if isinstance(cause, InputError):
        return cause.renamed(_join(path, cause.field) if cause.field else path)
    return InputError.of(path, str(cause or error))


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _types_inside(types: tuple[inspect.Type, ...], step: str | int) -> tuple[inspect.Type, ...]:
    """Return what a field or an item of a value of these types takes."""
    for one in types:
        match one:
            case inspect.StructType(fields=fields) if step in {each.encode_name for each in fields}:
                return next(members(each.type) for each in fields if each.encode_name == step)
            case inspect.DictType(value_type=value) if isinstance(step, str):
                return members(value)
            case inspect.VarTupleType(item_type=item) if isinstance(step, int):
                return members(item)
            case inspect.TupleType(item_types=items) if isinstance(step, int):
                return members(items[step])
    return ()


def _of_tag(types: tuple[inspect.Type, ...], value: object) -> tuple[inspect.Type, ...]:
    """Return those types whose tag the document names; all, where it names none."""
    if not isinstance(value, Mapping):
        return types
    tables = [one for one in types if isinstance(one, inspect.StructType) and one.tag_field]
    return tuple(one for one in tables if value.get(str(one.tag_field)) == one.tag) or types


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
