"""Writes `docs/scenarios.md`: every field that a scenario may have, by its name in TOML.

    .venv/bin/python -m launch_scripts.scenarios.scenario_document > docs/scenarios.md

Tables, names, types, bounds and defaults are read from the structs that scenarios are checked with,
what the fields mean from their docstrings. A test holds the file to this module.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any, Final, cast

from msgspec import NODEFAULT, inspect

from agents.cycle import KINDS
from bus_schemas.faults import LONGEST_MS
from launch_scripts.scenarios.field_notes import field_notes, first_paragraph
from launch_scripts.scenarios.scenario import Scenario

_OPENING: Final = """\
# Scenarios

A scenario is a TOML file: what a run is about. `heliarch launch FILE.toml` takes the path of your
own; those that come with Heliarch are in `launch_scripts/scenarios/`. Written by
`python -m launch_scripts.scenarios.scenario_document`, which reads names, types, bounds and
defaults from the code.

Every field is checked before anything starts. A field that stands in none of these tables is
refused, and those that its table has are named. Units stand in the names: `duration_s` is in
seconds, `rating_kw` in kilowatts. Times are numbers in that unit: `delay_ms = 5`, not `"5ms"`.
Files are looked for beside the scenario, in `--data` and beside the shipped scenarios. `heliarch
compare --set control.alpha_min=0.1` changes a field for one study.
"""

_NOTES: Final = {
    "faults": f"""\
One such table for each rule. Shares are 0 to 1, times 0 to {LONGEST_MS:,.0f} ms, and a rule must do
something. What `--fault` calls `delay=50ms`, `jitter=10ms` and `reorder-by=5ms` are `delay_ms`,
`jitter_ms` and `reorder_ms` here.

```toml
[[faults]]
source = "c1/*"
signal = "impp"
delay_ms = 50
jitter_ms = 10
loss = 0.02
silent = [[60, 90]]
```
""",
    "machine": f"""\
Kinds of processes are {", ".join(f"`{kind}`" for kind in KINDS)}.
`--cpus` and `--priority` take the place of the first two fields. What the machine does not permit
is said, and the run goes on without.

```toml
[machine]
cpus = ["0-1", "recorder=1"]
priority = 20
lock_memory = true
```
""",
    "timing": """\
Which budgets there are: [Budgets](timing.md#budgets).

```toml
[timing.budgets]
loop_p99_ms = 25
decision_p99_ms = { direct = 4 }
```
""",
}
"""What is to be known of a table besides its fields."""


def scenario_document() -> str:
    """Return the document as Markdown."""
    lines = [_OPENING, "## The file itself\n"]
    root = cast("inspect.StructType", inspect.type_info(Scenario))
    lines += _field_table(root)
    for field in root.fields:
        lines += _section(field.encode_name, field.type, 2)
    return "\n".join(lines).rstrip("\n") + "\n"


def _section(path: str, kind: inspect.Type, level: int) -> Iterator[str]:
    """Yield what is to be said of a table, and of those inside of it."""
    tables = [one for one in _members(kind) if isinstance(one, inspect.StructType)]
    if isinstance(kind, inspect.VarTupleType) and isinstance(kind.item_type, inspect.StructType):
        tables = [kind.item_type]
    if not tables:
        return
    name = f"[[{path}]]" if isinstance(kind, inspect.CollectionType) else f"[{path}]"
    yield f"{'#' * level} `{name}`\n"
    if len(tables) > 1:
        kinds = ", ".join(f"`{table.tag}`" for table in tables)
        yield f"`{tables[0].tag_field}` says which of these it is: {kinds}.\n"
    for table in tables:
        if len(tables) > 1:
            yield f'{"#" * (level + 1)} `{name}` with `{table.tag_field} = "{table.tag}"`\n'
        yield f"{first_paragraph(table.cls)}\n"
        yield from _field_table(table)
    if path in _NOTES:
        yield _NOTES[path]
    for table in tables:
        for field in table.fields:
            yield from _section(f"{path}.{field.encode_name}", field.type, level + 1)


def _field_table(table: inspect.StructType) -> Iterator[str]:
    notes = field_notes(table.cls)
    said = ""
    yield "| field | what it takes | default | what it is |"
    yield "|---|---|---|---|"
    for field in table.fields:
        # Fields that belong together share a note: it is told once.
        note = notes[field.name] if notes[field.name] != said else "see above"
        said = notes[field.name]
        yield f"| `{field.encode_name}` | {_takes(field.type)} | {_default(field)} | {note} |"
    yield ""


def _default(field: inspect.Field) -> str:
    if field.required:
        return "required"
    if field.default is NODEFAULT or field.default is None or field.default == ():
        return ""
    if isinstance(field.default, bool):
        return f"`{str(field.default).lower()}`"
    if isinstance(field.default, str):
        return f'`"{field.default}"`'
    if isinstance(field.default, int | float):
        return f"{field.default:.10g}"
    return ""


def _takes(kind: inspect.Type) -> str:
    """Say in words what a field takes."""
    words = [_takes_one(one) for one in _members(kind) if not isinstance(one, inspect.NoneType)]
    return " or ".join(dict.fromkeys(words))


def _takes_one(kind: inspect.Type) -> str:
    match kind:
        case inspect.LiteralType():
            return ", ".join(f'`"{value}"`' for value in kind.values)
        case inspect.IntType() | inspect.FloatType():
            return _number(kind)
        case inspect.VarTupleType():
            return f"list, each: {_takes(kind.item_type)}"
        case inspect.TupleType():
            return f"list of {len(kind.item_types)}: {_takes(kind.item_types[0])}"
    return _PLAIN[type(kind)]


_PLAIN: Final[dict[type[inspect.Type], str]] = {
    inspect.StructType: "table",
    inspect.DictType: "table",
    inspect.StrType: "text",
    inspect.BoolType: "`true` or `false`",
    inspect.DateTimeType: "date and time",
    inspect.TimeType: "time of day",
}


def _number(kind: inspect.IntType | inspect.FloatType) -> str:
    what = "whole number" if isinstance(kind, inspect.IntType) else "number"
    bounds: tuple[tuple[str, Any], ...] = (
        ("above", kind.gt),
        ("from", kind.ge),
        ("below", kind.lt),
        ("up to", kind.le),
    )
    said = [f"{word} {bound:.10g}" for word, bound in bounds if bound is not None]
    return f"{what} {', '.join(said)}".rstrip()


def _members(kind: inspect.Type) -> tuple[inspect.Type, ...]:
    """Return the types of a union, or the type itself."""
    return kind.types if isinstance(kind, inspect.UnionType) else (kind,)


def main() -> None:
    """Write the document to standard output."""
    sys.stdout.write(scenario_document())


if __name__ == "__main__":
    main()
