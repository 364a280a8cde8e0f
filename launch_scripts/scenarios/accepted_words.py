"""What a struct accepts, to be named in an error: words of a field of a few, fields of a table."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from msgspec import inspect


def accepted_words(struct: type[Any], path: str) -> tuple[str, ...]:
    """Return the words that a field accepts.

    There are none where it is no field of a few words, and where the path leads to several fields
    of different words (of structs that stand for one another). The field that tells such structs
    apart takes all their words.

    Parameters
    ----------
    struct
        A msgspec struct.
    path
        The field as msgspec names it in an error, without the leading `$.`:
        `control.scheme`, `faults[...].distribution`.
    """
    table, _, name = path.rpartition(".")
    if tags := _tags(struct, table, name):
        return tags
    fields = {
        tuple(map(str, one.values))
        for one in _types_at(struct, path)
        if isinstance(one, inspect.LiteralType)
    }
    return fields.pop() if len(fields) == 1 else ()


def _tags(struct: type[Any], table: str, field: str) -> tuple[str, ...]:
    """Return the words by which a field of a table tells structs apart; none if it does not."""
    return tuple(
        str(one.tag)
        for one in _types_at(struct, table)
        if isinstance(one, inspect.StructType) and one.tag_field == field
    )


def accepted_fields(struct: type[Any], path: str, document: object = None) -> tuple[str, ...]:
    """Return the names of the fields of a table, as a file writes them.

    Parameters
    ----------
    struct
        A msgspec struct.
    path
        The table as msgspec names it in an error; empty: the struct itself.
    document
        The file as it was read. Of structs that stand for one another it tells which is meant;
        where it does not, the fields of all of them are named.
    """
    names: dict[str, None] = {}
    for table in _types_at(struct, path, document):
        if isinstance(table, inspect.StructType):
            if table.tag_field is not None:
                names[table.tag_field] = None
            names |= dict.fromkeys(field.encode_name for field in table.fields)
    return tuple(names)


def _types_at(struct: type[Any], path: str, document: object = None) -> list[inspect.Type]:
    """Return the types that a path leads to, those of a union each for itself."""
    found = [inspect.type_info(struct)]
    for name in re.findall(r"[^.\[\]]+|\[[^\]]*\]", path):
        document = _inside_document(document, name)
        inner = [one for outer in found for one in _inside(outer, name)]
        found = list(_meant(inner, document))
    return found


def _inside(outer: inspect.Type, name: str) -> Iterator[inspect.Type]:
    """Yield the types that a part of a path leads to from a type."""
    if isinstance(outer, inspect.StructType):
        for field in outer.fields:
            if field.encode_name == name:
                yield from _members(field.type)
    elif isinstance(outer, inspect.CollectionType) and name.startswith("["):
        yield from _members(outer.item_type)


def _inside_document(document: object, name: str) -> object:
    if isinstance(document, Mapping):
        return document.get(name)
    place = name.strip("[]")
    if isinstance(document, Sequence) and place.isdecimal() and int(place) < len(document):
        return document[int(place)]
    return None


def _meant(types: Iterable[inspect.Type], document: object) -> Iterator[inspect.Type]:
    """Yield those types whose tag the document names; all, where it names none."""
    types = tuple(types)
    named = [
        one for one in types if isinstance(one, inspect.StructType) and _has_tag(one, document)
    ]
    yield from named or types


def _has_tag(struct: inspect.StructType, document: object) -> bool:
    if struct.tag_field is None or not isinstance(document, Mapping):
        return False
    return bool(document.get(struct.tag_field) == struct.tag)


def _members(one: inspect.Type) -> tuple[inspect.Type, ...]:
    """Return the types of a union, or the type itself."""
    return one.types if isinstance(one, inspect.UnionType) else (one,)
