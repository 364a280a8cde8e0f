"""What a struct takes is found, wherever it lies: words of a field, fields of a table."""

from __future__ import annotations

from typing import Literal

import msgspec
import pytest
from launch_scripts.scenarios.accepted_words import accepted_fields, accepted_words


class Inner(msgspec.Struct):
    manner: Literal["one", "two"]
    number: int = msgspec.field(name="count")


class Square(msgspec.Struct, tag=True):
    side: Literal["long", "short"]
    colour: Literal["red", "blue"]


class Circle(msgspec.Struct, tag=True):
    colour: Literal["red", "blue"]
    side: Literal["none"]


class Ball(msgspec.Struct, tag=True):
    radius: float


class Box(msgspec.Struct, tag=True):
    edge: float


class Solids(msgspec.Struct):
    solids: tuple[Ball | Box, ...]


class Outer(msgspec.Struct):
    inner: Inner
    several: tuple[Inner, ...]
    shape: Square | Circle
    either: float | Literal["max"]


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("inner.manner", ("one", "two")),
        ("several[3].manner", ("one", "two")),
        ("several[...].manner", ("one", "two")),
        ("either", ("max",)),
        ("shape.colour", ("blue", "red")),
        ("shape.side", ()),
        ("shape.type", ("Square", "Circle")),
        ("inner.type", ()),
        ("inner.number", ()),
        ("inner.nobody", ()),
        ("", ()),
    ],
)
def test_the_words_of_a_field(path: str, words: tuple[str, ...]) -> None:
    assert accepted_words(Outer, path) == words


@pytest.mark.parametrize(
    ("path", "names"),
    [
        ("", ("inner", "several", "shape", "either")),
        ("inner", ("manner", "count")),
        ("several[3]", ("manner", "count")),
        ("several[...]", ("manner", "count")),
        ("shape", ("type", "side", "colour")),
        ("either", ()),
        ("nobody", ()),
    ],
)
def test_the_fields_of_a_table(path: str, names: tuple[str, ...]) -> None:
    assert accepted_fields(Outer, path) == names


@pytest.mark.parametrize(
    ("kind", "names"),
    [("Ball", ("type", "radius")), ("Box", ("type", "edge"))],
)
def test_the_document_tells_which_struct_is_meant(kind: str, names: tuple[str, ...]) -> None:
    documents = {"solids": [{"type": "nothing"}, {"type": kind}]}
    assert accepted_fields(Solids, "solids[1]", documents) == names
    assert accepted_fields(Solids, "solids[1]") == ("type", "radius", "edge")


def test_the_word_that_tells_structs_of_a_list_apart() -> None:
    assert accepted_words(Solids, "solids[1].type") == ("Ball", "Box")
