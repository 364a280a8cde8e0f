"""The words that a field of a struct takes are found, wherever it lies."""

from __future__ import annotations

from typing import Literal

import msgspec
import pytest

from launch_scripts.accepted_words import accepted_words


class Inner(msgspec.Struct):
    manner: Literal["one", "two"]
    number: int


class Square(msgspec.Struct, tag=True):
    side: Literal["long", "short"]
    colour: Literal["red", "blue"]


class Circle(msgspec.Struct, tag=True):
    colour: Literal["red", "blue"]
    side: Literal["none"]


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
        ("inner.number", ()),
        ("inner.nobody", ()),
        ("", ()),
    ],
)
def test_the_words_of_a_field(path: str, words: tuple[str, ...]) -> None:
    assert accepted_words(Outer, path) == words
