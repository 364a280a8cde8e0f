"""The network faults of a run: the scenario's rules, and those of `--fault`."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

import msgspec

from bus_schemas.errors import InputError
from bus_schemas.faults import FaultRule, check_rule
from bus_schemas.times import duration_s, split_range
from bus_schemas.tree import ControlTree
from launch_scripts.scenarios.fields import readable
from launch_scripts.scenarios.scenario import ScenarioFile

_EXAMPLE: Final = "source=c1/*,signal=impp,delay=50ms,jitter=10ms,loss=2%,silent=60s..90s"
_NAMES: Final = ("source", "listener", "signal", "distribution", "partition", "kill", "freeze")
_TIMES: Final = {"delay": "delay_ms", "jitter": "jitter_ms", "reorder-by": "reorder_ms"}
_SHARES: Final = ("loss", "duplicate", "reorder")


def fault_rules(
    scenario_file: ScenarioFile,
    options: Sequence[str],
    tree: ControlTree,
    external: Collection[str] = (),
    addresses: Mapping[str, str] = {},
) -> tuple[FaultRule, ...]:
    """Return the rules of a run, the scenario's first."""
    rules = scenario_file.scenario.faults
    for place, rule in enumerate(rules):
        check_rule(rule, tree, f"faults[{place}]", external, addresses)
    for text in options:
        rule = parse_fault(text)
        check_rule(rule, tree, f"--fault {text}", external, addresses)
        rules += (rule,)
    return rules


def parse_fault(text: str) -> FaultRule:
    """Read a rule, `FIELD=VALUE,...`; `silent` may come several times.

    Whether it fits the run is checked by `check_rule`.
    """
    where, values = f"--fault {text}", dict[str, Any]()
    for part in text.split(","):
        field, _, value = (piece.strip() for piece in part.partition("="))
        if not value:
            raise InputError(f"{where}: expected fields such as {_EXAMPLE}, got {part.strip()!r}")
        name, read = _field(field, value, where)
        if name == "silent":
            values.setdefault(name, []).append(read)
        elif name in values:
            raise InputError(f"{where}: expected {field} once, got it twice")
        else:
            values[name] = read
    try:
        return msgspec.convert(values, FaultRule)
    except msgspec.ValidationError as error:
        raise InputError(f"{where}: {readable(error, FaultRule, values)}") from None


def _field(field: str, value: str, where: str) -> tuple[str, object]:
    """Return the field of a rule that is meant, and its value."""
    its_where = f"{where}: {field}"
    if field in _NAMES:
        return field, value
    if field in _TIMES:
        return _TIMES[field], _duration_s(value, its_where) * 1e3
    if field in _SHARES:
        return field, _share(value, its_where)
    if field in {"silent", "at"}:
        is_range = field == "silent" or ".." in value
        times = split_range(value, its_where) if is_range else (value,)
        return field, [_duration_s(time, its_where) for time in times]
    accepted = ", ".join((*_NAMES, *_TIMES, *_SHARES, "silent", "at"))
    raise InputError(f"{where}: expected {accepted}, got {field!r}")


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
