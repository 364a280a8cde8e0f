"""The errors that a command reports in one line, and what makes their text safe to show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches


class InputError(ValueError):
    """Bad input from a user: where, what was expected and what was found. Exit status 2."""


class FailureError(Exception):
    """What was asked for could not be done, for no fault of the input: exit status 1."""


class InputWarning(UserWarning):
    """Only a part of the user's input could be used; the text says which part is missing."""


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
