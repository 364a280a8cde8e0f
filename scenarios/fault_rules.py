"""The faults of a run: the scenario's, and those of `--fault`, with their grammar."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING, Any, Final

import msgspec

from agents.faults import Fault, Freeze, Kill, Trip, check_fault
from bus_schemas.errors import InputError, listed, not_one_of
from bus_schemas.faults import Blackout, Disturbance, Partition
from bus_schemas.tree import ControlTree
from scenarios.fields import checked
from scenarios.times import duration_s, read_seconds, split_range

if TYPE_CHECKING:
    from scenarios.scenario import ScenarioFile

_EXAMPLE: Final = "source=c1/*,signal=impp,delay=50ms,jitter=10ms,loss=2%,at=60s..90s"
_KINDS: Final[dict[str, tuple[type[Fault], str]]] = {
    "blackout": (Blackout, "at"),
    "partition": (Partition, "between"),
    "kill": (Kill, "agents"),
    "freeze": (Freeze, "agents"),
    "trip": (Trip, "agents"),
}
"""The words that name a kind of fault, and their field; without one it is a `Disturbance`."""

_TIMES: Final = {"delay": "delay_ms", "jitter": "jitter_ms", "reorder-by": "reorder_ms"}
"""The field of each word that is named otherwise."""

_NAMES: Final = ("source", "listener", "signal", "distribution", "loss", "duplicate", "reorder")
_WORDS: Final = (*_NAMES, *_TIMES, *_KINDS, "at")


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
    where = f"--fault {text}"
    words = _words(text, where)
    kinds = [word for word in words if word in _KINDS]
    if len(kinds) > 1:
        raise InputError.of(where, f"expected one kind of fault, got {listed(kinds)}")
    kind, values = _KINDS[kinds[0]][0] if kinds else Disturbance, dict[str, object]()
    for word, value in words.items():
        field = _KINDS[word][1] if word in _KINDS else _TIMES.get(word, word)
        if field in values or field not in kind.__struct_fields__:
            having = [name for name, (one, _) in _KINDS.items() if field in one.__struct_fields__]
            needed = f"no {kinds[0]}" if kinds else listed(having)
            raise InputError.of(where, f"{word}: expected {needed} with it")
        values[field] = _read(kind, word, value, f"{where}: {word}")
    try:
        return checked(values, kind)
    except InputError as error:
        raise InputError.of(where, str(error)) from None


def _words(text: str, where: str) -> dict[str, str]:
    words: dict[str, str] = {}
    for part in text.split(","):
        word, _, value = (piece.strip() for piece in part.partition("="))
        if not value:
            raise InputError.of(where, f"expected words such as {_EXAMPLE}, got {part.strip()!r}")
        if word in words:
            raise InputError.of(where, f"expected {word} once, got it twice")
        if word not in _WORDS:
            raise InputError.of(where, not_one_of(_WORDS, word, "the words "))
        words[word] = value
    return words


def _read(kind: type[Fault], word: str, value: str, where: str) -> object:
    read: object = value
    match word:
        case "delay" | "jitter" | "reorder-by":
            read = _seconds(value, where, duration_s) * 1e3
        case "loss" | "duplicate" | "reorder":
            read = _share(value, where)
        case "partition":
            read = value.split("|")
        case "at" | "blackout" if kind is not Kill:
            read = [_seconds(time, where) for time in split_range(value, where)]
        case "at":
            read = _seconds(value, where)
    return read


def fault_text(fault: Fault) -> str:
    """Return a fault as `--fault` reads it, without what is the default."""
    names = {field: word for word, field in _TIMES.items()}
    names |= {field: word for word, (kind, field) in _KINDS.items() if isinstance(fault, kind)}
    return ",".join(
        f"{names.get(field.name, field.name)}={_text(field.name, value)}"
        for field in msgspec.structs.fields(fault)
        if (value := getattr(fault, field.name)) != field.default
    )


def _text(field: str, value: str | float | tuple[Any, ...]) -> str:
    match field:
        case "at":
            times_s = value if isinstance(value, tuple) else (value,)
            return "..".join(f"{time_s:.15g}s" for time_s in times_s)
        case "between" if isinstance(value, tuple):
            return "|".join(value)
    return f"{value}ms" if field in _TIMES.values() else str(value)


def _seconds(text: str, where: str, read: Callable[[str], float | None] = read_seconds) -> float:
    if (found_s := read(text)) is None:
        raise InputError.of(where, f"expected a time such as 50ms, 60s or 2m, got {text!r}")
    return found_s


def _share(text: str, where: str) -> float:
    try:
        return float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        raise InputError.of(where, f"expected a share such as 2% or 0.02, got {text!r}") from None
