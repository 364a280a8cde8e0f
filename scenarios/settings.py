"""Settings: fields of a scenario that a command or a study changes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime, time
from typing import Any

import msgspec

from bus_schemas.codec import UNREADABLE
from bus_schemas.errors import InputError
from scenarios.fields import checked
from scenarios.scenario import Scenario, ScenarioFile


@dataclass(frozen=True, slots=True)
class Setting:
    """A field of the scenario and the values that it takes, one after another."""

    field: str
    values: tuple[object, ...]


def parse_setting(text: str) -> Setting:
    """Read `commitment.share=0.5,0.7`: a field, and its values as TOML; `1..20` are 20 values."""
    field, _, values = (part.strip() for part in text.partition("="))
    if not re.fullmatch(r"\w+(\.\w+)*", field) or not values:
        raise InputError.of(
            "--set", f"expected a field and values such as commitment.share=0.5,0.7, got {text}"
        )
    if numbers := re.fullmatch(r"(\d{1,6})\.\.(\d{1,6})", values):
        return Setting(field, tuple(range(int(numbers[1]), int(numbers[2]) + 1)))
    listed = _toml(f"[{values}]")
    if not isinstance(listed, list):  # Words without quotes are no TOML.
        listed = [_toml(value.strip()) for value in values.split(",")]
    return Setting(field, tuple(listed))


def _toml(text: str) -> object:
    """Return the value of a TOML expression, or the text if it is none."""
    try:
        return msgspec.toml.decode(f"value = {text}")["value"]
    except UNREADABLE:
        return text


def with_single_settings(scenario: ScenarioFile, texts: Iterable[str]) -> ScenarioFile:
    """Return a scenario with the fields changed that texts name, one value for each."""
    settings = [parse_setting(text) for text in texts]
    for setting in settings:
        if len(setting.values) != 1:
            got = f"got {len(setting.values)}"
            raise InputError.of(f"--set {setting.field}", f"expected one value, {got}")
    return with_settings(scenario, [(one.field, one.values[0]) for one in settings])


def with_settings(scenario: ScenarioFile, chosen: Sequence[tuple[str, object]]) -> ScenarioFile:
    """Return a scenario with these fields changed to these values, which may be NumPy's."""
    if not chosen:
        return scenario
    document = msgspec.to_builtins(scenario.scenario, builtin_types=(datetime,))
    stated = msgspec.toml.decode(scenario.text)
    fields = [(field, plain(value)) for field, value in chosen]
    for field, value in fields:
        _put(document, field, value)
        _put(stated, field, value)
    where = " ".join(f"--set {field}={setting_text(value)}" for field, value in fields)
    try:
        changed = checked(document, Scenario)
    except InputError as error:
        raise InputError.of(where, str(error)) from None
    text = _toml_text(stated)
    return msgspec.structs.replace(scenario, scenario=changed, text=text, source="")


def _put(document: dict[str, Any], field: str, value: object) -> None:
    """Set a field. A value in the place of a table is replaced; its new fields are checked later.

    A table changes the fields that it names, and removes those that it names as None; one of
    another kind replaces the old one.
    """
    *tables, name = field.split(".")
    for part in tables:
        if not isinstance(document.get(part), dict):
            document[part] = {}
        document = document[part]
    old = document.get(name)
    document[name] = _merged(old, value) if isinstance(old, dict) else value


def _merged(old: dict[str, Any], value: object) -> object:
    if isinstance(value, Mapping) and value.get("kind", old.get("kind")) == old.get("kind"):
        return {name: new for name, new in {**old, **value}.items() if new is not None}
    return value


def plain(value: object) -> object:
    """Return a value of Python or NumPy as one that TOML has."""

    def converted(other: object) -> object:
        return getattr(other, "tolist", other.__str__)()

    return msgspec.to_builtins(value, builtin_types=(date, datetime, time), enc_hook=converted)


def setting_text(value: object) -> str:
    """Return a value as `--set` reads it."""
    return value if isinstance(value, str) else _toml_value(value)


def _toml_text(document: Mapping[str, Any]) -> str:
    """Return a scenario as TOML: each top-level table under its heading, nested ones inline."""
    tables = {name: value for name, value in document.items() if isinstance(value, Mapping)}
    lines = [_toml_line(name, value) for name, value in document.items() if name not in tables]
    for name, table in tables.items():
        lines += ["", f"[{name}]", *(_toml_line(*entry) for entry in table.items())]
    return "\n".join(lines) + "\n"


def _toml_line(name: str, value: object) -> str:
    return f"{name} = {_toml_value(value)}"


def _toml_value(value: object) -> str:
    if isinstance(value, Mapping):
        return f"{{{', '.join(_toml_line(*entry) for entry in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml_value, value))}]"
    if isinstance(value, date | time):
        return value.isoformat()
    if isinstance(value, float):
        return repr(value)  # TOML writes inf and nan as Python does.
    return json.dumps(value, ensure_ascii=False)
