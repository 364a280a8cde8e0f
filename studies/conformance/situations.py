"""The situations that a device is put into, in their order."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf, nan
from typing import Any, Final

from bus_schemas.codec import encode
from bus_schemas.messages import (
    Dispatch,
    Impp,
    Message,
    Meter,
    Residual,
    Setpoint,
    Telemetry,
)
from bus_schemas.signals import Port
from bus_schemas.tree import PLANT
from studies.conformance.trial import Trial

_UNDISTURBED: Final = 5
_RANDOM: Final = 10
"""Cycles of random inputs."""
_RANDOM_FAULTS: Final = 12
"""Cycles in real time in which inputs have random fates."""

_FATES: Final = ("in time", "in time", "lost", "twice", "late", "held back")

_RANGES: Final[dict[type[Message], tuple[float, float]]] = {
    Dispatch: (-0.2, 1.2),
    Impp: (0.0, 1.0),
    Setpoint: (0.0, 1.0),
    Meter: (0.0, 1.0),
    Residual: (-1.0, 1.0),
    Telemetry: (0.0, 1.04),
}
"""Bounds of random powers, as shares of the rating."""


@dataclass(frozen=True)
class Situation:
    """A few cycles with inputs of their own; the answers show a requirement."""

    requirement: str
    play: Callable[[Trial, random.Random], None]


def undisturbed(trial: Trial, draw: random.Random) -> None:
    for _ in range(_UNDISTURBED):
        trial.play()


def _at_limits(trial: Trial, draw: random.Random) -> None:
    for port in _one_of_each(trial):
        for values in _extremes(trial, port):
            if port in trial.ports():
                trial.play({port: (encode(trial.message(port, **values)),)})


def _wrong_messages(trial: Trial, draw: random.Random) -> None:
    for kind in ("bytes", "fields", "source", "ahead", "again", "before"):
        for port in _one_of_each(trial):
            if port in trial.ports():
                trial.play({port: tuple(_wrong(trial, port, kind))})
                trial.play()


def _replaced_neighbours(trial: Trial, draw: random.Random) -> None:
    """Let each controller among the publishers be replaced, and its predecessor speak again."""
    for publisher in {port.publisher for port in _one_of_each(trial)} - {PLANT}:
        trial.incarnations[publisher] = trial.cycle
        trial.play()
        edit = {}
        for port in trial.ports():
            if port.publisher == publisher:
                other_kw = 0.25 * trial.plan.tree.rating_kw(port.node)
                former = trial.message(port, incarnation=0, power_kw=other_kw)
                edit[port] = (encode(former), encode(trial.message(port)))
        trial.play(edit)


def _random_inputs(trial: Trial, draw: random.Random) -> None:
    for _ in range(_RANDOM):
        trial.play({port: (encode(_random(trial, port, draw)),) for port in trial.ports()})


def _missing_inputs(trial: Trial, draw: random.Random) -> None:
    of_plant = [port for port in trial.ports(0) if port.publisher == PLANT]
    for ports in (*_units(trial), of_plant):
        trial.play(dict.fromkeys(ports, ()))
        trial.play()


def _expired_inputs(trial: Trial, draw: random.Random) -> None:
    of_setpoint = [port for port in trial.ports(0) if port.signal.type in (Dispatch, Setpoint)]
    for ports in (*_units(trial), of_setpoint):
        for _ in range(trial.plan.control.hold_cycles + 2):
            trial.play(dict.fromkeys(ports, ()))
        trial.play()


def _late_inputs(trial: Trial, draw: random.Random) -> None:
    for ports in _units(trial):
        late = {port: (encode(trial.message(port)),) for port in ports if port in trial.ports()}
        trial.play(dict.fromkeys(ports, ()), late=late)
        trial.play(dict.fromkeys(ports, ()))
        trial.play()


def _random_faults(trial: Trial, draw: random.Random) -> None:
    """Lose, repeat, delay and reorder inputs; something of the plant comes in each cycle."""
    held: dict[Port[Message], tuple[bytes, ...]] = {}
    for _ in range(_RANDOM_FAULTS):
        edit, late = {}, {}
        of_plant = [port for port in trial.ports() if port.publisher == PLANT]
        unharmed = draw.choice(of_plant)
        for port in trial.ports():
            message = encode(trial.message(port))
            older = held.pop(port, ())
            fate = "in time" if port == unharmed else draw.choice(_FATES)
            now = {"in time": (message,), "twice": (message, message)}.get(fate, ())
            first, second = draw.sample((older, now), 2)
            edit[port] = (*first, *second)
            if fate == "late":
                late[port] = (message,)
            elif fate == "held back":
                held[port] = (message,)
        trial.play(edit, late=late)


IN_LOCKSTEP: Final = (
    Situation("decisions", undisturbed),
    Situation("limits", _at_limits),
    Situation("wrong messages", _wrong_messages),
    Situation("replaced", _replaced_neighbours),
    Situation("decisions", _random_inputs),
)
"""Situations that need no clock."""

IN_REAL_TIME: Final = (
    Situation("decisions", undisturbed),
    Situation("missing", _missing_inputs),
    Situation("expired", _expired_inputs),
    Situation("late", _late_inputs),
    Situation("random faults", _random_faults),
)
"""Situations in which inputs come late or not at all."""


def _units(trial: Trial) -> list[list[Port[Message]]]:
    """Return inputs that come and stay away together: of the plant each one, of others all.

    Of several children the first one stands for all.
    """
    found: dict[str, list[Port[Message]]] = {}
    for port in _one_of_each(trial):
        name = str(port) if port.publisher == PLANT else port.publisher
        found.setdefault(name, []).append(port)
    return list(found.values())


def _one_of_each(trial: Trial) -> list[Port[Message]]:
    """Return the first port of each signal that is heard."""
    return list({port.signal: port for port in reversed(trial.ports(0))}.values())


def _extremes(trial: Trial, port: Port[Message]) -> list[dict[str, float]]:
    """Return fields of an input at and beyond what they can be."""
    rating_kw, kind = trial.plan.tree.rating_kw(port.node), port.signal.type
    above_kw = 1.5 * rating_kw
    if kind is Telemetry:
        limited = {"power_kw": 0.3 * rating_kw, "alpha": 0.5}
        return [
            *({"power_kw": share * rating_kw, "alpha": 1.0} for share in (0.0, 1.0, 1.04)),
            *({**limited, "available_kw": power_kw} for power_kw in (0.9 * rating_kw, above_kw)),
            *({"power_kw": wrong} for wrong in (above_kw, -1.0, nan)),
            *({"alpha": wrong} for wrong in (0.0, 1.5, -0.5, nan)),
        ]
    if kind is Dispatch:
        powers = [{"power_kw": value} for value in (0.0, -500.0, above_kw, nan, inf)]
        return [*powers, {"plant_rating_kw": 0.0}, {"plant_rating_kw": nan}]
    low_kw = -rating_kw if kind is Residual else 0.0
    wrong_low_kw = 3.0 * low_kw - 1.0
    return [{"power_kw": value} for value in (low_kw, rating_kw, wrong_low_kw, above_kw, nan)]


def _wrong(trial: Trial, port: Port[Message], kind: str) -> Iterator[bytes]:
    """Yield what no sender should send in a cycle, beside the right message."""
    right = encode(trial.message(port))
    other: dict[str, Any] = {"power_kw": 0.25 * trial.plan.tree.rating_kw(port.node)}
    cycle = trial.cycle
    match kind:
        case "bytes":
            yield from (b"", b"\xc1", right[:-1], right + b"\xc0", b"\x93\x01\x02\x03")
        case "fields":
            yield right.replace(b"\xa8power_kw", b"\xa8power_xx")
            yield right.replace(b"\xa5cycle", b"\xa5cycel")
        case "source":
            yield encode(trial.message(port, source="nobody", **other))
        case "ahead":
            beyond = trial.plan.timing.cycles if port.publisher == PLANT else cycle
            beyond += trial.plan.control.periods.longest + 3
            yield encode(trial.message(port, cycle=beyond, **other))
    yield right
    if kind == "again":
        yield encode(trial.message(port, **other))
    if kind == "before":
        yield encode(trial.message(port, cycle=max(cycle - 2, 0), **other))


def _random(trial: Trial, port: Port[Message], draw: random.Random) -> Message:
    """Return a message with random numbers within their bounds."""
    rating_kw, kind = trial.plan.tree.rating_kw(port.node), port.signal.type
    if kind not in _RANGES:
        return trial.message(port)
    changes = {"power_kw": draw.uniform(*_RANGES[kind]) * rating_kw}
    if kind is Telemetry:
        changes["alpha"] = draw.choice((1.0, draw.uniform(trial.plan.control.alpha_min, 1.0)))
        if draw.random() < 0.5:
            changes["available_kw"] = draw.uniform(0.0, 1.04) * rating_kw
    return trial.message(port, **changes)
