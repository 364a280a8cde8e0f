"""Writes TOML: the text of a scenario after fields of it were changed."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import date, time
from typing import Any


def toml_text(document: Mapping[str, Any]) -> str:
    """Return a document as TOML: each top-level table under its heading, nested ones inline."""
    tables = {name: value for name, value in document.items() if isinstance(value, Mapping)}
    lines = [_line(name, value) for name, value in document.items() if name not in tables]
    for name, table in tables.items():
        lines += ["", f"[{_key(name)}]", *(_line(*entry) for entry in table.items())]
    return "\n".join(lines) + "\n"


def _line(name: str, value: object) -> str:
    return f"{_key(name)} = {toml_value(value)}"


def _key(name: str) -> str:
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name, ensure_ascii=False)


def toml_value(value: object) -> str:
    if isinstance(value, Mapping):
        return f"{{{', '.join(_line(*entry) for entry in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, date | time):
        return value.isoformat()
    if isinstance(value, float):
        return repr(value)  # TOML writes inf and nan as Python does.
    return json.dumps(value, ensure_ascii=False)
