"""The cases of a study: one scenario on many days, with many settings and faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, time
from itertools import chain, product
from math import prod
from typing import Final

from bus_schemas.errors import InputError
from scenarios.preparation import RunOptions
from scenarios.scenario import ScenarioFile, local_start
from scenarios.settings import Setting, setting_text, with_settings
from scenarios.times import parse_moment

_MOST: Final = 100_000
_NO_FAULT: Final = "none"


@dataclass(frozen=True, slots=True)
class Case:
    """One run of a study.

    `columns` has what may differ from case to case: fields of the scenario by name, such as
    `commitment.share`, and `fault`, `day` and `seed` where the study has them.
    """

    columns: Mapping[str, object]
    scenario: ScenarioFile
    options: RunOptions


def label(columns: Mapping[str, object]) -> str:
    """Name a case: `share=0.5 fault=delay=1s day=2010-04-01 seed=3`."""
    return " ".join(
        f"{name.rpartition('.')[2]}={value if isinstance(value, date) else setting_text(value)}"
        for name, value in columns.items()
    )


def parse_seeds(text: str) -> tuple[int, ...]:
    """Read `1..5,9`."""
    return _numbers(text, int, "--seeds: expected whole numbers and ranges such as 1..5,9")


def parse_days(text: str) -> tuple[date, ...]:
    """Read `2010-04-01`, `2010-04-01..2010-04-30`, or several of them with commas."""
    expected = "--days: expected dates and ranges such as 2010-04-01..2010-04-30"
    days = _numbers(text, lambda day: date.fromisoformat(day.strip()).toordinal(), expected)
    return tuple(map(date.fromordinal, days))


def _numbers(text: str, read: Callable[[str], int], expected: str) -> tuple[int, ...]:
    """Return the numbers of a list of numbers and ranges, each once."""
    try:
        ends = [[read(end) for end in part.split("..", 1)] for part in text.split(",")]
    except ValueError:
        ends = []
    ranges = [range(one[0], one[-1] + 1) for one in ends]
    if not ranges or not all(ranges) or sum(map(len, ranges)) > _MOST:  # They may not fit.
        raise InputError(f"{expected}, from low to high, at most {_MOST:,}, got {text!r}")
    return tuple(dict.fromkeys(chain.from_iterable(ranges)))


def cases(
    scenario: ScenarioFile,
    options: RunOptions,
    settings: Sequence[Setting] = (),
    faults: Sequence[str] = (),
    days: Sequence[date] = (),
    seeds: Sequence[int] = (),
) -> list[Case]:
    """List every combination of settings, faults, days and seeds.

    A fault is `none`, one rule, or several that act together: `delay=1s;loss=5%`.

    Raises InputError: A setting does not fit the scenario, or there are too many cases.
    """
    choices = [[(setting.field, value) for value in setting.values] for setting in settings]
    count = prod(len(values) or 1 for values in (*choices, faults, days, seeds))
    if count > _MOST:
        raise InputError.of(
            "--days, --seeds, --set", f"expected at most {_MOST:,} cases, got {count:,}"
        )
    listed = []
    for chosen in product(*choices):
        changed = with_settings(scenario, chosen)
        for fault, day, seed in product(faults or (None,), days or (None,), seeds or (None,)):
            columns, its_options = dict(chosen), options
            if fault is not None:
                columns["fault"] = fault
                rules = [] if fault == _NO_FAULT else fault.split(";")
                its_options = replace(its_options, faults=rules)
            if day is not None:
                columns["day"] = day
                its_options = replace(its_options, start=_start_on(day, changed, options))
            if seed is not None:
                columns["seed"] = seed
                its_options = replace(its_options, seed=seed)
            listed.append(Case(columns, changed, its_options))
    return listed


def _start_on(day: date, scenario: ScenarioFile, options: RunOptions) -> str:
    start = options.start
    clock = (
        local_start(scenario.scenario.time).time()
        if start is None
        else parse_moment(start, "--from")
    )
    if not isinstance(clock, time):
        raise InputError.of(
            "--from", f"expected a time of day such as 12:30 with --days, got {start}"
        )
    return datetime.combine(day, clock).isoformat()
