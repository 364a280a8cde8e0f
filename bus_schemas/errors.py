"""The errors that a command reports in one line, and what makes their text safe to show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from typing import Self


class InputError(ValueError):
    """Bad input from a user: where, what was expected and what was found. Exit status 2.

    `field` is the option, or the field of a scenario, that is wrong: `--pace`, `plant.grid`; it is
    empty where a file is at fault. `place` is where that stands, such as a file and its line.
    """

    def __init__(self, complaint: str, *, field: str = "", place: str = "") -> None:
        super().__init__(complaint)
        self.complaint, self.field, self.place = complaint, field, place

    @classmethod
    def of(cls, field: str, complaint: str) -> Self:
        """Return the error that a field is not as expected: `expected X, got Y`."""
        return cls(complaint, field=field)

    def within(self, place: str) -> Self:
        """Return the same error with a place before it."""
        place = ": ".join(filter(None, (place, self.place)))
        return type(self)(self.complaint, field=self.field, place=place)

    def renamed(self, field: str) -> Self:
        """Return the same error about a field that the user knows by another name."""
        return type(self)(self.complaint, field=field, place=self.place)

    def __str__(self) -> str:
        return ": ".join(filter(None, (self.place, self.field, self.complaint)))


class FailureError(Exception):
    """The input is sound, and the task failed: exit status 1."""


class InputWarning(UserWarning):
    """A part of the user's input could not be used; the text says which."""


def not_one_of(known: Iterable[str], name: str, what: str = "one of ") -> str:
    """Say `expected one of A, B, got a; did you mean A?` of a name that is not known."""
    names = list(known)
    similar = get_close_matches(name, names)
    hint = f"; did you mean {' or '.join(similar)}?" if similar else ""
    return f"expected {what}{listed(names, 20)}, got {name!r}{hint}"


def listed(names: Sequence[str], most: int = 12) -> str:
    """Return the first of many names, and the number of the others: `a, b and 7 more`."""
    rest = len(names) - most
    first = ", ".join(names[:most])
    return f"{first} and {rest} more" if rest > 0 else first


def printable(text: str) -> str:
    """Return a text with each control character as its escape: a terminal must not obey it."""
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() or one in "\n\t" else one.encode("unicode_escape").decode()
        for one in text
    )
