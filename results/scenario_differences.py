"""What differs between the scenarios of two recorded runs: settings, faults, overridden options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import msgspec
import pandas as pd

from agents.plan import RunPlan
from recordings.read.reader import RunReader
from results.tables import Cell, Table, key_column, word_column
from scenarios.fault_rules import fault_text

_OF_EACH_RUN: Final = ("run_id", "protocol", "access.", "supervision.machine.", "faults.rules")
"""What differs from run to run without a difference of the scenarios, or has lines of its own."""

_LONGEST: Final = 48
"""Longer values are only said to differ: clusters, positions, settings of inverters."""

_ABSENT: Final = "-"


def scenario_differences(first: RunReader, second: RunReader) -> Table:
    """Return a line for each difference: faults first, then the plans, then the scenario files.

    A field of the scenario comes where the plan has none of its name and values: weather, data.
    """
    rows = [*_fault_rows(first.plan, second.plan)]
    rows += _rows(*(_flat(msgspec.to_builtins(reader.plan)) for reader in (first, second)))
    known = {(_last(row[0]), *row[1:]) for row in rows}
    tables = (_flat(reader.scenario_table()) for reader in (first, second))
    rows += [row for row in _rows(*tables) if (_last(row[0]), *row[1:]) not in known]
    columns = key_column("setting"), word_column("A"), word_column("B")
    note = "" if rows else "none: both runs have the same scenario, settings and faults"
    return Table("What differs in scenario and settings", columns, rows, (note,) if note else ())


def _fault_rows(first: RunPlan, second: RunPlan) -> Iterator[tuple[Cell, ...]]:
    texts = [[fault_text(fault) for fault in plan.faults.rules] for plan in (first, second)]
    for text in dict.fromkeys([*texts[0], *texts[1]]):
        counts = [one.count(text) for one in texts]
        if counts[0] != counts[1]:
            yield "fault", *(text if count else "none" for count in counts)


def _rows(first: Mapping[str, Any], second: Mapping[str, Any]) -> Iterator[tuple[Cell, ...]]:
    for name in dict.fromkeys([*first, *second]):
        values = first.get(name, _ABSENT), second.get(name, _ABSENT)
        if values[0] != values[1] and not name.startswith(_OF_EACH_RUN):
            texts = [_text(value) for value in values]
            yield name, *(texts if max(map(len, texts)) <= _LONGEST else ("given", "differs"))


def _last(name: Cell) -> str:
    """Return the name of a setting without its tables: they differ in plan and scenario."""
    return str(name).rpartition(".")[2]


def _flat(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of nested tables by their path, such as `control.scheme`."""
    (flat,) = pd.json_normalize(dict(tables)).to_dict("records")
    return {str(name): value for name, value in flat.items()}


def _text(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
