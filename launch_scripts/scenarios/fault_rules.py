"""In what ways a run's network is imperfect: the scenario's rules, and those of `--fault`.

An option reads `--fault source=c1/*,signal=impp,delay=50ms,jitter=10ms,loss=2%,silent=60s..90s`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from typing import Any, Final

import msgspec

from bus_schemas.errors import InputError
from bus_schemas.faults import UNHEARD, FaultRule, check_rule
from bus_schemas.tree import ControlTree
from launch_scripts.scenarios.scenario import ScenarioFile

_EXAMPLE: Final = "source=c1/*,signal=impp,delay=50ms,jitter=10ms,loss=2%,silent=60s..90s"
_WORDS: Final = ("source", "listener", "signal", "distribution")
_TIMES: Final = {"delay": "delay_ms", "jitter": "jitter_ms", "reorder-by": "reorder_ms"}
_SHARES: Final = ("loss", "duplicate", "reorder")
_MS: Final = {"us": 1e-3, "ms": 1.0, "s": 1e3, "m": 60e3, "h": 3600e3}
_NUMBER: Final = r"\d+(?:\.\d*)?|\.\d+"


def fault_rules(
    scenario_file: ScenarioFile,
    options: Sequence[str],
    tree: ControlTree,
    external: Collection[str] = (),
) -> tuple[FaultRule, ...]:
    """Return the rules of a run, the scenario's first.

    Raises
    ------
    InputError
        A rule cannot be read, or does not fit the run.
    """
    rules = scenario_file.scenario.faults
    for place, rule in enumerate(rules):
        check_rule(rule, tree, f"{scenario_file.path}: faults[{place}]", external)
    for text in options:
        rule = parse_fault(text)
        check_rule(rule, tree, f"--fault {text}", external)
        rules += (rule,)
    return rules


def fault_remarks(rules: Sequence[FaultRule]) -> tuple[str, ...]:
    """Say of which signals faults change nothing, a line each."""
    unheard = dict.fromkeys(rule.signal for rule in rules if rule.signal in UNHEARD)
    return tuple(
        f"faults on {signal} change nothing: no agent acts on {signal}" for signal in unheard
    )


def parse_fault(text: str) -> FaultRule:
    """Read a rule from its words, each with its value; `silent` may come several times.

    Raises
    ------
    InputError
        A word or a value is not accepted. Whether they fit the run is not looked at here.
    """
    values: dict[str, Any] = {}
    for part in text.split(","):
        word, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not value:
            raise InputError(f"--fault {text}: {part.strip()!r}, accepted is such as {_EXAMPLE}")
        if word == "silent":
            values.setdefault("silent", []).append(_interval_s(value, text))
            continue
        name, read = _field(word, value, text)
        if name in values:
            raise InputError(f"--fault {text}: {word} twice, accepted is once")
        values[name] = read
    try:
        return msgspec.convert(values, FaultRule)
    except msgspec.ValidationError as error:
        raise InputError(f"--fault {text}: {error}") from None


def _field(word: str, value: str, text: str) -> tuple[str, str | float]:
    if word in _WORDS:
        return word, value
    if word in _TIMES:
        return _TIMES[word], _time_ms(value, word, text)
    if word in _SHARES:
        return word, _share(value, word, text)
    accepted = ", ".join((*_WORDS, *_TIMES, *_SHARES, "silent"))
    raise InputError(f"--fault {text}: {word!r} is not known, accepted: {accepted}")


def _time_ms(value: str, word: str, text: str) -> float:
    found = re.fullmatch(rf"({_NUMBER})(us|ms|s|m|h)", value)
    if found is None:
        raise InputError(
            f"--fault {text}: {word} is {value!r}, accepted is a time with its unit such as 50ms, "
            "0.05s or 2m"
        )
    return float(found[1]) * _MS[found[2]]


def _share(value: str, word: str, text: str) -> float:
    found = re.fullmatch(rf"({_NUMBER})(%?)", value)
    if found is None:
        raise InputError(
            f"--fault {text}: {word} is {value!r}, accepted is a share such as 2% or 0.02"
        )
    return float(found[1]) / (100.0 if found[2] else 1.0)


def _interval_s(value: str, text: str) -> tuple[float, float]:
    begin, dots, end = value.partition("..")
    if not dots:
        raise InputError(
            f"--fault {text}: silent is {value!r}, accepted is an interval such as 60s..90s"
        )
    return _time_ms(begin, "silent", text) / 1e3, _time_ms(end, "silent", text) / 1e3
