"""The faults of a run: the scenario's, and those of `--fault`, with their grammar."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any, Final

import msgspec

from agents.faults import Fault, Freeze, Kill, Trip, check_fault
from bus_schemas.errors import InputError, not_one_of
from bus_schemas.faults import Blackout, Disturbance, Partition
from bus_schemas.tree import ControlTree
from scenarios.fields import checked
from scenarios.times import duration_s, split_range

if TYPE_CHECKING:
    from scenarios.scenario import ScenarioFile

_EXAMPLE: Final = "source=c1/*,signal=impp,delay=50ms,jitter=10ms,loss=2%,at=60s..90s"
_KINDS: Final[dict[str, type[Fault]]] = {
    "blackout": Blackout,
    "partition": Partition,
    "kill": Kill,
    "freeze": Freeze,
    "trip": Trip,
}
"""The words that name a kind of fault; without one of them it is a `Disturbance`."""

_TIMES: Final = {"delay": "delay_ms", "jitter": "jitter_ms", "reorder-by": "reorder_ms"}
_FIELDS: Final = {
    **_TIMES,
    "blackout": "at",
    "partition": "between",
    "kill": "agents",
    "freeze": "agents",
    "trip": "agents",
}
"""The field of each word that is named otherwise."""

_NAMES: Final = ("source", "listener", "signal", "distribution", "loss", "duplicate", "reorder")
_WORDS: Final = (*_NAMES, *_TIMES, *_KINDS, "at", "until", "zombie")


def fault_rules(
    scenario_file: ScenarioFile,
    options: Sequence[str],
    tree: ControlTree,
    external: Collection[str] = (),
    addresses: Collection[str] = (),
) -> tuple[Fault, ...]:
    """Return the faults of a run, the scenario's first."""
    faults = scenario_file.scenario.faults
    for number, fault in enumerate(faults):
        check_fault(fault, tree, f"{scenario_file.path}: faults[{number}]", external, addresses)
    for text in options:
        fault = parse_fault(text)
        check_fault(fault, tree, f"--fault {text}", external, addresses)
        faults += (fault,)
    return faults


def parse_fault(text: str) -> Fault:
    """Read a fault, `WORD=VALUE,...`; whether it fits the run is checked by `check_fault`."""
    where, words = f"--fault {text}", dict[str, str]()
    for part in text.split(","):
        word, _, value = (piece.strip() for piece in part.partition("="))
        if not value:
            raise InputError(f"{where}: expected words such as {_EXAMPLE}, got {part.strip()!r}")
        if word in words:
            raise InputError(f"{where}: expected {word} once, got it twice")
        words[word] = value
    kind = next((_KINDS[word] for word in words if word in _KINDS), Disturbance)
    values: dict[str, Any] = {}
    for word, value in words.items():
        field, read = _field(kind, word, value, where)
        if field in values:
            raise InputError(f"{where}: expected one kind of fault, got {word} as well")
        values[field] = read
    return checked(values, kind, where)


def _field(kind: type[Fault], word: str, value: str, where: str) -> tuple[str, object]:
    """Return the field of a fault that a word sets, and its value."""
    if word not in _WORDS:
        raise InputError(f"{where}: {not_one_of(_WORDS, word, 'the words ')}")
    read: object = value
    where = f"{where}: {word}"
    if word in _TIMES:
        read = _duration_s(value, where) * 1e3
    elif word in {"loss", "duplicate", "reorder"}:
        read = _share(value, where)
    elif word == "partition":
        read = value.split("|")
    elif word == "until" or (word == "at" and kind is Kill):
        read = _duration_s(value, where)
    elif word == "zombie":
        read = {"yes": True, "no": False}.get(value, value)
    elif word in {"at", "blackout"}:
        read = [_duration_s(time, where) for time in split_range(value, where)]
    return _FIELDS.get(word, word), read


def fault_text(fault: Fault) -> str:
    """Return a fault as `--fault` reads it, without what is the default."""
    names = {field: word for word, field in _TIMES.items()}
    for word, kind in _KINDS.items():
        if isinstance(fault, kind):
            names[_FIELDS[word]] = word
    words = []
    for field in msgspec.structs.fields(fault):
        value = getattr(fault, field.name)
        if value == field.default:
            continue
        if field.name == "at":
            times_s = (value,) if isinstance(fault, Kill) else value
            value = "..".join(f"{time_s:.15g}s" for time_s in times_s)
        elif field.name == "until":
            value = f"{value:.15g}s"
        elif field.name == "zombie":
            value = "yes"
        elif field.name == "between":
            value = "|".join(value)
        elif field.name in _TIMES.values():
            value = f"{value}ms"
        words.append(f"{names.get(field.name, field.name)}={value}")
    return ",".join(words)


def _duration_s(text: str, where: str) -> float:
    found_s = duration_s(text)
    if found_s is None:
        raise InputError(f"{where}: expected a duration such as 50ms, 0.05s or 2m, got {text!r}")
    return found_s


def _share(text: str, where: str) -> float:
    try:
        return float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        raise InputError(f"{where}: expected a share such as 2% or 0.02, got {text!r}") from None
