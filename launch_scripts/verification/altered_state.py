"""An agent's state with every number in it altered, once to less and once to more.

What an agent says from all three alike does not depend on what it remembers. Two would not do: a
value that ends at a rating, or at zero, often comes to the same from a state nearby.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final, TypeAlias

import msgspec
import numpy as np

Part: TypeAlias = Any
"""A state, or a part of one: what an agent remembers is its own business."""

ALTERATIONS: Final = ((0, 0), (2, 1000))
"""Factor and summand of each alteration: nothing at all, and more than any inverter's rating."""


def altered_states(state: Part) -> list[Part]:
    """Return states of the same kind with other numbers, one for each alteration.

    Structs, dataclasses, lists, tuples, values of mappings and arrays are taken apart. Text and
    objects of another kind stay as they are.
    """
    return [_altered(state, factor, summand) for factor, summand in ALTERATIONS]


def _altered(part: Part, factor: int, summand: int) -> Part:
    if isinstance(part, bool):
        return bool(summand)
    if isinstance(part, int | float | np.ndarray):
        return part * factor + summand
    if isinstance(part, list | tuple):
        entries = [_altered(entry, factor, summand) for entry in part]
        return type(part)(*entries) if hasattr(part, "_fields") else type(part)(entries)
    return _altered_fields(part, factor, summand)


def _altered_fields(part: Part, factor: int, summand: int) -> Part:
    if isinstance(part, dict):
        return {name: _altered(value, factor, summand) for name, value in part.items()}
    if isinstance(part, msgspec.Struct):
        values = {name: getattr(part, name) for name in part.__struct_fields__}
        return msgspec.structs.replace(part, **_altered(values, factor, summand))
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        values = {entry.name: getattr(part, entry.name) for entry in dataclasses.fields(part)}
        return dataclasses.replace(part, **_altered(values, factor, summand))
    return part
