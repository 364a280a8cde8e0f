"""The cases of a study: one scenario on many days, with many settings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta
from itertools import chain, product
from math import prod
from typing import Any, Final

import msgspec

from bus_schemas.errors import InputError
from bus_schemas.times import read_time
from launch_scripts.scenarios.fields import readable
from launch_scripts.scenarios.preparation import RunOptions
from launch_scripts.scenarios.scenario import Scenario, ScenarioFile, check_scenario, local_start
from launch_scripts.scenarios.toml_text import toml_text, toml_value

_MOST: Final = 100_000


@dataclass(frozen=True, slots=True)
class Setting:
    """A field of the scenario and the values that it takes in a study."""

    field: str
    values: tuple[object, ...]


@dataclass(frozen=True, slots=True)
class Case:
    """One day with one choice of settings, which is one part of its label."""

    label: str
    settings: str
    scenario: ScenarioFile
    options: RunOptions


def parse_setting(text: str) -> Setting:
    """Read `commitment.share=0.5,0.7`: a field of the scenario, and its values as TOML."""
    field, _, values = (part.strip() for part in text.partition("="))
    if not re.fullmatch(r"\w+(\.\w+)*", field) or not values:
        raise InputError(
            f"--set: expected a field and values such as commitment.share=0.5,0.7, got {text}"
        )
    listed = _toml(f"[{values}]")
    if not isinstance(listed, list):  # Words without quotes are no TOML.
        listed = [_toml(value.strip()) for value in values.split(",")]
    return Setting(field, tuple(listed))


def _toml(text: str) -> object:
    """Return the value of a TOML expression, or the text if it is none."""
    try:
        return msgspec.toml.decode(f"value = {text}")["value"]
    except (msgspec.DecodeError, RecursionError):
        return text


def with_settings(scenario: ScenarioFile, texts: Sequence[str]) -> ScenarioFile:
    """Return a scenario with some of its fields changed, one value for each."""
    chosen = []
    for text in texts:
        setting = parse_setting(text)
        if len(setting.values) > 1:
            raise InputError(f"--set {setting.field}: expected one value, got {text}")
        chosen.append((setting.field, setting.values[0]))
    return _with_settings(scenario, chosen)


def parse_seeds(text: str) -> tuple[int, ...]:
    """Read `1..5,9`."""
    if not re.fullmatch(r"\d+(\.\.\d+)?(,\d+(\.\.\d+)?)*", text):
        raise InputError(f"--seeds: expected whole numbers and ranges such as 1..5,9, got {text!r}")
    ranges = []
    for part in text.split(","):
        first, _, last = part.partition("..")
        ranges.append(range(int(first), int(last or first) + 1))
    if not all(ranges) or sum(map(len, ranges)) > _MOST:  # Not listed yet: it may not fit.
        raise InputError(
            f"--seeds: expected ranges from low to high, at most {_MOST:,} seeds, got {text}"
        )
    return tuple(dict.fromkeys(chain.from_iterable(ranges)))


def parse_days(text: str) -> tuple[date, ...]:
    """Read `2010-04-01`, `2010-04-01..2010-04-30`, or several of them with commas."""
    found: list[date] = []
    try:
        for part in text.split(","):
            first, _, last = part.partition("..")
            begin = date.fromisoformat(first.strip())
            end = date.fromisoformat(last.strip()) if last else begin
            found += [begin + timedelta(days=day) for day in range((end - begin).days + 1)]
    except ValueError:
        found = []
    if not found:
        raise InputError(
            f"--days: expected dates and ranges such as 2010-04-01..2010-04-30, got {text!r}"
        )
    return tuple(found)


def cases(
    scenario: ScenarioFile,
    options: RunOptions,
    settings: Sequence[Setting] = (),
    days: Sequence[date] = (),
    seeds: Sequence[int] = (),
) -> list[Case]:
    """List every combination of days, seeds and settings; InputError where one does not fit."""
    choices = [[(setting.field, value) for value in setting.values] for setting in settings]
    count = prod(map(len, choices)) * max(len(days), 1) * max(len(seeds), 1)
    if count > _MOST:
        raise InputError(f"--days, --seeds, --set: expected at most {_MOST:,} cases, got {count:,}")
    found = []
    for chosen in product(*choices):
        changed = _with_settings(scenario, chosen)
        names = [f"{field.rpartition('.')[2]}={_text(value)}" for field, value in chosen]
        for day, seed in product(days or (None,), seeds or (None,)):
            its_options, label = options, [*names]
            if day is not None:
                its_options = _on(day, changed, its_options)
                label.append(day.isoformat())
            if seed is not None:
                its_options = replace(its_options, seed=seed)
                label.append(f"seed={seed}")
            found.append(Case(" ".join(label), " ".join(names), changed, its_options))
    return found


def _on(day: date, scenario: ScenarioFile, options: RunOptions) -> RunOptions:
    start = options.start
    clock = local_start(scenario.scenario.time).time() if start is None else read_time(start)
    if not isinstance(clock, time):
        raise InputError(f"--from: expected a time of day such as 12:30 with --days, got {start}")
    return replace(options, start=datetime.combine(day, clock).isoformat())


def _with_settings(scenario: ScenarioFile, chosen: Sequence[tuple[str, object]]) -> ScenarioFile:
    if not chosen:
        return scenario
    document = msgspec.to_builtins(scenario.scenario, builtin_types=(datetime,))
    stated = msgspec.toml.decode(scenario.text)
    for field, value in chosen:
        _put(document, field, value)
        _put(stated, field, value)
    settings = " ".join(f"--set {field}={_text(value)}" for field, value in chosen)
    try:
        changed = msgspec.convert(document, Scenario, str_keys=True)
        check_scenario(changed, settings)
    except msgspec.ValidationError as error:
        raise InputError(f"{settings}: {readable(error, Scenario, document)}") from None
    return msgspec.structs.replace(scenario, scenario=changed, text=toml_text(stated))


def _put(document: dict[str, Any], field: str, value: object) -> None:
    """Set a field; what stands in the place of a table gives way, and is refused later."""
    *tables, name = field.split(".")
    for part in tables:
        if not isinstance(document.get(part), dict):
            document[part] = {}
        document = document[part]
    document[name] = value


def _text(value: object) -> str:
    return value if isinstance(value, str) else toml_value(value)
