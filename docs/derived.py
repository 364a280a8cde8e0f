"""Fills what documents show of the code: tables between two comments, and the example messages.

    PYTHONPATH=. .venv/bin/python docs/derived.py

rewrites `docs/commands.md`, `docs/scenarios.md`, `docs/wire.md`, `docs/wire-vectors.json` and the
test vector of `docs/own-device.md`. The prose is written there by hand; a test compares the files,
and the parts between `<!-- table: NAME -->` and `<!-- end -->`, with the code.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from functools import cache
from inspect import cleandoc
from itertools import groupby
from pathlib import Path
from typing import Any, Final, cast

import msgspec
from cyclopts.argument import Argument
from msgspec import NODEFAULT, inspect

from agents.agent import Agent, Stage
from agents.cycle import stage_of
from agents.loop import Loop
from agents.plan import RunPlan, changed
from agents.team import controller, controllers
from bus_schemas.bounds import BOUNDS, LARGEST, Bound
from bus_schemas.codec import encode
from bus_schemas.messages import HelpGiven, Message
from bus_schemas.signals import (
    COMMAND,
    DISPATCH,
    SETPOINT,
    SIGNALS,
    TELEMETRY,
    Port,
)
from bus_schemas.tree import CENTRAL, PLANT, ROOT
from docs.shown import fill, write
from heliarch.cli.app import COMMANDS, app
from scenarios.fields import members, takes
from scenarios.preparation import Preparation, RunOptions, prepare
from scenarios.scenario import Scenario, load_scenario
from sim_plant.plant import Plant

DOCUMENTS: Final = ("docs/commands.md", "docs/scenarios.md", "docs/wire.md")
VECTORS: Final = "docs/wire-vectors.json"
VECTOR: Final = "own-device-vector"
INVERTER: Final = "c2/inv07"

_MARKED: Final = re.compile(r"(<!-- table: (.*?) -->\n).*?(<!-- end -->)", re.DOTALL)


@cache
def _example() -> Preparation:
    """Return a run in real time, for what depends on a plant."""
    return prepare(load_scenario("oahu"), RunOptions(duration="1", pace=1.0), "example")


def filled(text: str) -> str:
    """Return a document with all that is derived in it as the code has it now."""
    return _MARKED.sub(lambda found: f"{found[1]}{table(found[2])}{found[3]}", text)


def table(name: str) -> str:
    """Return what stands between the comments of a name, such as `signals` or `scenario time`."""
    what, _, which = name.partition(" ")
    of_one = {"commands": _commands, "scenario": _scenario_table}
    of_all = {"signals": _signals, "types": _types, "stages": _stages, "bounds": _bounds}
    return "".join(f"{line}\n" for line in (of_one[what](which) if which else of_all[what]()))


def _rows(header: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> Iterator[str]:
    yield f"| {' | '.join(header)} |"
    yield "|" + "---|" * len(header)
    for row in rows:
        cells = (str(cell).replace("|", r"\|") for cell in row)
        yield f"| {' | '.join(cells)} |"


# Commands


def _commands(heading: str) -> Iterator[str]:
    return _rows(
        ("command", "what it does"),
        ((f"`heliarch {name}{_arguments(name)}`", _first_line(name)) for name in COMMANDS[heading]),
    )


def _first_line(command: str) -> str:
    return app[command].help.partition("\n\n")[0]


def _arguments(command: str) -> str:
    """Return the arguments of a command, and the options that it needs."""
    texts = []
    for argument in _parameters(command):
        name = argument.name
        if name.startswith("--") and argument.required:
            texts.append(f"{name} {argument.parameter.metavar or name[2:].upper()}")
        elif not name.startswith("--"):
            texts.append(name if argument.required else f"[{name}]")
    return "".join(f" {text}" for text in texts)


def _parameters(command: str) -> list[Argument]:
    collection = app[command].assemble_argument_collection(parse_docstring=True)
    return [argument for argument in collection if argument.show]


# Scenarios


def scenario_tables() -> dict[str, dict[str, inspect.StructType]]:
    """Return the tables of a scenario by name, each by its kinds; "" where there is one kind.

    A type that stands in two places is shown at the first one.
    """
    found: dict[str, dict[str, inspect.StructType]] = {}
    seen = set()

    def add(path: str, kind: inspect.Type) -> None:
        kinds = members(kind)
        for one in kinds:
            if isinstance(one, inspect.VarTupleType):
                add(path, one.item_type)
            if isinstance(one, inspect.StructType) and one.cls not in seen:
                seen.add(one.cls)
                found.setdefault(path, {})[str(one.tag) if len(kinds) > 1 else ""] = one
                for field in one.fields:
                    add(f"{path}.{field.encode_name}".removeprefix("file."), field.type)

    add("file", inspect.type_info(Scenario))
    return found


def _scenario_table(name: str) -> Iterator[str]:
    """Show the fields of a table; what several kinds, or several fields, share stands once."""
    kinds: dict[tuple[str, str, str], list[str]] = {}
    for kind, struct in scenario_tables()[name].items():
        described = descriptions(struct.cls)
        for field in struct.fields:
            if field.name in described:
                words = described[field.name]
                if "_" in field.name:  # Its name says the unit.
                    words = re.sub(r" \[[^]]+\](?=[.;,])", "", words)
                mark = r"\*" if field.required else ""
                row = (f"`{field.encode_name}`{mark}", _values(field), words)
                kinds.setdefault(row, []).append(kind)
    rows: dict[tuple[str, str, str], list[str]] = {}
    for (field, values, words), of_kinds in kinds.items():
        rows.setdefault((", ".join(of_kinds), values, words), []).append(field)
    table = (
        (kind, f"{', '.join(fields)}: {values}", words)
        for (kind, values, words), fields in rows.items()
    )
    start = 1 if "" in scenario_tables()[name] else 0
    return _rows(
        ("kind", "field: values (default)", "what it is")[start:], (r[start:] for r in table)
    )


_SHORTER: Final = {
    r" up to \d{7,}": "",
    r" such as \S+": "",
    "true or false": "boolean",
    "whole number": "integer",
    r"table from (.*) to (.*)": r"\2 for each of \1",
    r"list, each: list, each: (\w+)": r"lists of \1s",
    r"list(?: of \d)?, each: (\w+)": r"\1s",
    r"list, each: ": "list of ",
    r"(?<=from |bove )(\S+) up to": r"\1 to",
    r"\bnumber (?=from|above)": "",
    r"from (\S+) to": r"\1 to",
}
"""How the values of a field are said in a table; bounds of a million and more go unsaid."""


def _values(field: inspect.Field) -> str:
    said = takes(members(field.type))
    for pattern, short in _SHORTER.items():
        said = re.sub(pattern, short, said)
    return f"{said}{_default(field)}"


def descriptions(struct: type[Any]) -> dict[str, str]:
    """Return what the docstrings of a struct say of its fields, each `name: text`."""
    text = "\n".join(cleandoc(owner.__doc__ or "") for owner in struct.__mro__)
    found = re.findall(r"^(\w+): (.*(?:\n    .*)*)", text, re.MULTILINE)
    return {name: " ".join(words.split()) for name, words in found}


def _default(field: inspect.Field) -> str:
    match field.default:
        case bool() | str():
            return f" ({json.dumps(field.default)})"
        case int() | float():
            return f" ({field.default:.10g})"
    return ""


# On the wire


def _signals() -> Iterator[str]:
    tree = _example().plan.tree
    return _rows(
        ("key", "published by", "heard by", "how often"),
        (
            (
                f"`<plant>/{'' if row.nodes(tree) == (ROOT,) else '<path>/'}{row.name}`",
                row.publisher.value,
                ", ".join(role.value for role in row.listeners) or "recorder",
                row.occurrence.value,
            )
            for row in SIGNALS
        ),
    )


def _types() -> Iterator[str]:
    """Say what each type is, with the fields that it has beside those of every message."""
    return _rows(
        ("type", "fields"),
        (
            (f"`{kind.__name__}`: {cleandoc(kind.__doc__ or '').splitlines()[0]}", _fields(kind))
            for kind in (Message, *(row.type for row in SIGNALS))
        ),
    )


def _fields(kind: type[Message]) -> str:
    known = () if kind is Message else Message.__struct_fields__
    fields = cast("inspect.StructType", inspect.type_info(kind)).fields
    return _named(field for field in fields if field.name not in known)


def _named(fields: Iterable[inspect.Field]) -> str:
    """Name fields with type and default, neighbours alike in both together."""
    found = []
    for remark, alike in groupby(fields, _remark):
        names = [f"`{field.name}`" for field in alike]
        each = "each " if len(names) > 1 else ""
        found.append(", ".join(names) + (f" ({each}{remark})" if remark else ""))
    return "; ".join(found)


def _remark(field: inspect.Field) -> str:
    """Say the type and default of a field; nothing of a float without a default."""
    remarks = [_type_name(field.type)]
    if not field.required:
        remarks.append(_unless_given(field.default))
    return ", ".join(filter(None, remarks))


def _unless_given(value: object) -> str:
    if value is NODEFAULT:
        return "absent without storages"
    return f"default {'nil' if value is None else json.dumps(value)}"


def _type_name(kind: inspect.Type) -> str:
    """Name a type; empty for a float, which most fields are."""
    match kind:
        case inspect.UnionType():
            there = [one for one in kind.types if not isinstance(one, inspect.NoneType)]
            return " or ".join(map(_type_name, there))
        case inspect.LiteralType():
            return " or ".join(f"`{value}`" for value in kind.values)
        case inspect.VarTupleType(item_type=inspect.StructType() as entry):
            return f"array of arrays [{_named(entry.fields)}]"
        case inspect.VarTupleType():
            return f"array of {_type_name(kind.item_type) or 'float'}s"
    names: dict[type[inspect.Type], str] = {
        inspect.IntType: "integer",
        inspect.FloatType: "",
        inspect.StrType: "string",
        inspect.BoolType: "boolean",
    }
    return names[type(kind)]


def _stages() -> Iterator[str]:
    return _rows(
        ("agent", "stage", "awaits", "uses as well", "publishes", "deadline"),
        (
            (
                kind,
                stage.name,
                ", ".join(sorted({port.signal.name for port in stage.awaits})),
                ", ".join(sorted({port.signal.name for port in stage.uses})),
                ", ".join(_published(agent, stage)),
                "at the tick" if stage.timed else f"{_deadline_share(agent, stage):.3f}",
            )
            for kind, agent in _team()
            for stage in agent.stages(0)
        ),
    )


def _deadline_share(agent: Agent[Any], stage: Stage) -> float:
    plan = _example().plan
    return plan.deadlines.deadline_ns(agent.name, stage.name) / plan.timing.cycle_wall_ns


def _team() -> Iterator[tuple[str, Agent[Any]]]:
    plan, profile = _example().plan, _example().profile
    team = {agent.name: agent for agent in (Plant(plan, profile), *controllers(plan))}
    yield "plant", team[PLANT]
    yield "direct controller", team[INVERTER]
    yield "supervisor", team["c2"]
    yield "central controller", team[CENTRAL]


def _published(agent: Agent[Any], stage: Stage) -> Iterator[str]:
    tree = _example().plan.tree
    for row in SIGNALS:
        ports = [row.of(node) for node in row.nodes(tree)]
        own = [port for port in ports if port.publisher == agent.name]
        if row.is_cyclic and own and stage_of(own[0], tree) == stage.name:
            yield row.name


def _bounds() -> Iterator[str]:
    fields: dict[str, list[str]] = {}
    for kind, bounds in BOUNDS.items():
        for bound in bounds:
            low, high = (_bound(bound, value) for value in (bound.low, bound.high))
            pair = f"± {high}" if bound.low == -bound.high else f"{low} to {high}"
            said = low if bound.high == LARGEST else pair
            fields.setdefault(said, []).append(f"`{kind.__name__}.{bound.field}`")
    return _rows(("fields", "bounds"), ((", ".join(names), said) for said, names in fields.items()))


def _bound(bound: Bound, value: float) -> str:
    """Say a bound in words; those of powers are multiples of a rating."""
    if abs(value) == LARGEST:
        return "any finite number"
    if 0.0 < value < 1e-300:
        return "above 0"
    share = f"{round(value, 6):g}"
    if not bound.field.endswith("_kw") or value == 0.0:
        return share
    return {"1": "the rating", "-1": "- the rating"}.get(share, f"{share} times the rating")


# A direct controller at work

_INPUTS: Final = (TELEMETRY.of(INVERTER), DISPATCH.of(ROOT), SETPOINT.of(INVERTER))
_VECTOR: Final[tuple[tuple[dict[str, float] | None, ...], ...]] = (
    ({"power_kw": 250.0, "alpha": 1.0}, {"power_kw": 4000.0}, {"power_kw": 200.0}),
    ({"power_kw": 192.5, "alpha": 0.8}, {"power_kw": 4200.0}, {"power_kw": 240.0}),
    (
        {"power_kw": 230.0, "alpha": 0.9, "available_kw": 301.0},
        {"power_kw": 9000.0},
        {"power_kw": 301.0},
    ),
    ({"power_kw": -30.0, "alpha": 1.0}, {"power_kw": 3900.0}, {"power_kw": 7.0}),
    (None, {"power_kw": 3800.0}, None),
    ({"power_kw": 310.0, "alpha": 1.0}, None, None),
    ({"power_kw": 320.0, "alpha": 1.0}, {"power_kw": 3700.0}, None),
    ({"power_kw": 330.0, "alpha": 1.0}, {"power_kw": 3600.0}, None),
    ({"power_kw": 340.0, "alpha": 1.0}, {"power_kw": 3500.0}, {"power_kw": 150.0}),
    *[(None, {"power_kw": 3500.0}, {"power_kw": 150.0})] * 2,
    (None, {"power_kw": 3500.0}, {"power_kw": 0.0}),
    ({"power_kw": -3.0, "alpha": 1.0}, {"power_kw": 3500.0}, {"power_kw": 0.0}),
)
"""Fields of telemetry, dispatch and setpoint in each cycle; None: the message does not come."""


@cache
def _cycles() -> list[list[tuple[Port[Message], Message]]]:
    """Return what a direct controller hears and says in each cycle of the test vector."""
    plan = changed(
        _example().plan,
        control={"scheme": "paper", "hold_cycles": 2},
        timing={"cycles": len(_VECTOR)},
    )
    ours = Loop(controller(plan, INVERTER), plan)
    ours.begin(0, 0)
    found = []
    for cycle, of_inputs in enumerate(_VECTOR):
        one = list(_heard(plan, cycle, of_inputs))
        for port, message in one:
            ours.hear(port, message, 0)
        for _ in ("estimate", "actuate"):
            for port, message in ours.close_stage(0, is_overdue=True) or ():
                message.ready_time_ns = message.publish_time_ns = 0
                message.sequence = cycle
                one.append((port, message))
        found.append(one)
    return found


def _heard(
    plan: RunPlan, cycle: int, of_inputs: Iterable[dict[str, float] | None]
) -> Iterator[tuple[Port[Message], Message]]:
    rest: dict[str, dict[str, Any]] = {
        "telemetry": {"limit_kw": plan.tree.rating_kw(INVERTER)},
        "dispatch": {
            "plant_rating_kw": plan.tree.rating_kw(ROOT),
            "commitment_kw": 0.0,
            "regulation_kw": 0.0,
        },
        "setpoint": {"share_kw": 0.0, "help_given": (HelpGiven("c2/inv03", 20.0),)},
    }
    for port, fields in zip(_INPUTS, of_inputs, strict=True):
        if fields is not None:
            head = (cycle, plan.timing.sim_time_ns(cycle), port.publisher, (), 0, 0, cycle)
            yield port, port.signal.type(*head, **(rest[port.signal.name] | fields))


def vectors() -> str:
    """Return messages of cycle 1 as JSON: key, fields, and bytes in hexadecimal digits."""
    found = {
        port.signal.name: {
            "key": _example().plan.wiring.key(port),
            "message": msgspec.to_builtins(message),
            "bytes": encode(message).hex(),
        }
        for port, message in _cycles()[1]
        if port in {*_INPUTS[::2], COMMAND.of(INVERTER)}
    }
    return json.dumps(found, indent=1) + "\n"


def vector() -> list[list[str]]:
    """Return the fields that matter in each cycle, each number with all its digits."""
    fields = {
        "telemetry": ("power_kw", "alpha", "available_kw"),
        "dispatch": ("power_kw",),
        "setpoint": ("power_kw",),
        "impp": ("power_kw", "stale_cycles"),
        "residual": ("power_kw",),
        "command": ("alpha", "power_kw"),
    }
    rows = [["cycle", *(f"{name}: {', '.join(of)}" for name, of in fields.items())]]
    for number, cycle in enumerate(_cycles()):
        of_signal = {port.signal.name: message for port, message in cycle}
        row = [str(number)]
        for signal, names in fields.items():
            message = of_signal.get(signal)
            values = [] if message is None else [getattr(message, name) for name in names]
            row.append(" ".join(repr(value) for value in values if value is not None) or "-")
        rows.append(row)
    return rows


def main() -> None:
    """Rewrite the documents."""
    for name in DOCUMENTS:
        path = Path(name)
        path.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")
    Path(VECTORS).write_text(vectors(), encoding="utf-8")
    write(VECTOR, vector())
    fill()


if __name__ == "__main__":
    main()
