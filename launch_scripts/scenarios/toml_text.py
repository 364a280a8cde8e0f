"""Writes TOML: the text of a scenario after fields of it were changed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from datetime import date, time
from typing import Any


def toml_text(document: Mapping[str, Any]) -> str:
    """Return a document as TOML: each top-level table under its heading, nested ones inline."""
    return "\n".join(_lines(document)) + "\n"


def _lines(document: Mapping[str, Any]) -> Iterator[str]:
    for name, value in document.items():
        if not isinstance(value, Mapping):
            yield f"{_key(name)} = {toml_value(value)}"
    for name, table in document.items():
        if isinstance(table, Mapping):
            yield f"\n[{_key(name)}]"
            yield from (f"{_key(field)} = {toml_value(value)}" for field, value in table.items())


def _key(name: str) -> str:
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name, ensure_ascii=False)


def toml_value(value: object) -> str:
    if isinstance(value, Mapping):
        return (
            "{"
            + ", ".join(f"{_key(name)} = {toml_value(one)}" for name, one in value.items())
            + "}"
        )
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, date | time):
        return value.isoformat()
    if isinstance(value, float):
        return repr(value)  # TOML writes inf and nan as Python does.
    return json.dumps(value, ensure_ascii=False)
