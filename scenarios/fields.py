"""What the fields of a scenario take: to check a document, and for the documentation."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from types import SimpleNamespace, UnionType
from typing import Annotated, Any, Final, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import inspect

from bus_schemas.errors import InputError, not_one_of

_T = TypeVar("_T")

_NO_BOUND: Final = 1e12
"""A bound that only keeps infinity out."""

_HEADING: Final = re.compile(r"\s*(\[\[?)\s*([\w.-]+)\s*\]+\s*(#.*)?$")
_ENTRY: Final = re.compile(r"\s*([\w.-]+)\s*=")


def checked(document: object, kind: type[_T], where: str = "", text: str = "") -> _T:
    """Return a document as a struct, or refuse it with all fields that are wrong.

    `text` is the TOML that the document was read from, which says in which line a field stands.
    """
    try:
        return msgspec.convert(document, kind, str_keys=True)
    except msgspec.ValidationError:
        wrong = [one.within(line_of(one.field, text)) for one in _refusals(document, kind, "")]
    first, *others = wrong
    complaint = "; ".join([first.complaint, *map(str, others)])
    raise InputError(complaint, field=first.field, place=first.place).within(where)


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


def _refusals(value: object, kind: object, path: str) -> Iterator[InputError]:
    """Yield what is wrong in a value, if anything is; `kind` is its type, as annotations say it."""
    try:
        msgspec.convert(value, kind, str_keys=True)
    except msgspec.ValidationError as error:
        inside = list(_refusals_inside(value, kind, path))
        cause = error.__cause__  # From a `__post_init__`, about the table or one of its fields.
        if inside:
            yield from inside
        elif isinstance(cause, InputError):
            yield _inside(path, cause)
        else:
            expected = takes(members(inspect.type_info(kind)))
            yield InputError.of(path, f"expected {expected}, got {value!r:.60}")


def _refusals_inside(value: object, kind: object, path: str) -> Iterator[InputError]:
    types = members(inspect.type_info(kind))
    tables = [one for one in types if isinstance(one, inspect.StructType)]
    alternatives = {get_origin(one): get_args(one) for one in _alternatives(kind)}
    if isinstance(value, Mapping) and tables:
        if len(tables) > 1:
            tag = str(tables[0].tag_field)
            of_tag = [one for one in tables if one.tag == value.get(tag)]
            if not of_tag:
                expected = " or ".join(f'"{table.tag}"' for table in tables)
                got = value.get(tag, "nothing")
                yield InputError.of(_join(path, tag), f"expected {expected}, got {got!r:.60}")
            tables = of_tag
        for table in tables:
            yield from _table_refusals(value, table, path)
    elif isinstance(value, Mapping) and dict in alternatives:
        for name, one in value.items():
            yield from _refusals(one, alternatives[dict][1], _join(path, name))
    elif isinstance(value, list) and tuple in alternatives:
        for at, one in enumerate(value):
            yield from _refusals(one, alternatives[tuple][0], f"{path}[{at}]")


def _table_refusals(
    value: Mapping[str, Any], table: inspect.StructType, path: str
) -> Iterator[InputError]:
    kinds = get_type_hints(table.cls, include_extras=True)
    fields = {field.encode_name: field for field in table.fields}
    known = [*([table.tag_field] if table.tag_field else []), *fields]
    right = {field.name: field.default for field in table.fields if not field.required}
    for name, one in value.items():
        if name not in known:
            yield InputError.of(_join(path, name), not_one_of(known, name, "the fields "))
        elif name in fields:
            own = fields[name].name
            wrong = list(_refusals(one, kinds[own], _join(path, name)))
            yield from wrong
            if not wrong:
                right[own] = msgspec.convert(one, kinds[own], str_keys=True)
    for name, field in fields.items():
        if field.required and name not in value:
            expected = takes(members(field.type))
            yield InputError.of(_join(path, name), f"expected {expected}, got nothing")
    yield from (_inside(path, one) for one in _refusals_of_all(table, right))


def _refusals_of_all(
    table: inspect.StructType, right: Mapping[str, object]
) -> Iterator[InputError]:
    """Yield what is wrong with a table whose other fields are wrong, if these do not matter."""
    check: Any = getattr(table.cls, "__post_init__", None)
    try:
        if check is not None:
            check(SimpleNamespace(**right))
    except InputError as error:
        yield error
    except (AttributeError, TypeError):
        pass  # It needs a field that is wrong.


def _inside(path: str, error: InputError) -> InputError:
    return error.renamed(_join(path, error.field) if error.field else path)


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _alternatives(kind: object) -> Iterator[object]:
    """Yield the types of a union, or the type itself, without descriptions."""
    if get_origin(kind) is Annotated:
        yield from _alternatives(get_args(kind)[0])
    elif get_origin(kind) in {Union, UnionType}:
        for one in get_args(kind):
            yield from _alternatives(one)
    else:
        yield kind


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
