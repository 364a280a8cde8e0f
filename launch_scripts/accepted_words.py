"""Which words a field of a struct accepts that takes one of a few: to be named in an error."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from msgspec import inspect


def accepted_words(struct: type[Any], path: str) -> tuple[str, ...]:
    """Return the words that a field accepts.

    There are none where it is no field of a few words, and where the path leads to several fields
    of different words (of structs that stand for one another).

    Parameters
    ----------
    struct
        A msgspec struct.
    path
        The field as msgspec names it in an error, without the leading `$.`:
        `control.late`, `faults[...].distribution`.
    """
    types = [inspect.type_info(struct)]
    for name in re.findall(r"[^.\[\]]+|\[[^\]]*\]", path):
        types = [inner for outer in types for inner in _inside(outer, name)]
    fields = {
        tuple(map(str, known.values))
        for one in types
        for known in _members(one)
        if isinstance(known, inspect.LiteralType)
    }
    return fields.pop() if len(fields) == 1 else ()


def _inside(outer: inspect.Type, name: str) -> Iterator[inspect.Type]:
    """Yield the types that a part of a path leads to from a type."""
    for one in _members(outer):
        if isinstance(one, inspect.StructType):
            yield from (field.type for field in one.fields if field.encode_name == name)
        elif isinstance(one, inspect.CollectionType) and name.startswith("["):
            yield one.item_type


def _members(one: inspect.Type) -> tuple[inspect.Type, ...]:
    """Return the types of a union, or the type itself."""
    return one.types if isinstance(one, inspect.UnionType) else (one,)
