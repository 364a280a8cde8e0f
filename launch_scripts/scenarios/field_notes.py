"""What the docstring of a struct says of its fields: documents are made from it."""

from __future__ import annotations

import inspect
from typing import Any


def field_notes(struct: type[Any]) -> dict[str, str]:
    """Return what numpydoc docstrings say of a struct's fields, on one line each.

    Several names may share a note, and what follows a name's colon is passed over. Fields of the
    structs that it inherits from are told too.
    """
    found: dict[str, str] = {}
    for one in reversed(struct.__mro__):
        found |= _of_docstring(one.__dict__.get("__doc__") or "")
    return found


def first_paragraph(struct: type[Any]) -> str:
    """Return the first paragraph of a struct's docstring, on one line."""
    return " ".join(inspect.cleandoc(struct.__doc__ or "").partition("\n\n")[0].split())


def without_field_notes(struct: type[Any]) -> str:
    """Return a struct's docstring up to where it comes to its fields."""
    return inspect.cleandoc(struct.__doc__ or "").partition("\nAttributes\n---")[0].rstrip()


def _of_docstring(docstring: str) -> dict[str, str]:
    found: dict[str, str] = {}
    names: list[str] = []
    for line in inspect.cleandoc(docstring).partition("----------\n")[2].splitlines():
        if line.startswith(" "):
            for name in names:
                found[name] = f"{found.get(name, '')} {line.strip()}".strip()
        else:
            names = [name.strip() for name in line.partition(" : ")[0].split(",") if name.strip()]
    return found
