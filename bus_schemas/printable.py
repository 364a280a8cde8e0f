"""Makes text from the bus or a file safe to show."""

from __future__ import annotations


def printable(text: str) -> str:
    """Return a text with each control character as its escape: a terminal must not obey it."""
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() or one in "\n\t" else one.encode("unicode_escape").decode()
        for one in text
    )
