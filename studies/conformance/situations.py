"""What happens to a device in a trial: each situation is a few cycles with inputs of its own."""

from __future__ import annotations

import random
from collections.abc import Iterator
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

UNDISTURBED: Final = 5
RANDOM: Final = 10
"""Cycles of random inputs."""
RANDOM_FAULTS: Final = 12
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


def in_lockstep(trial: Trial, seed: int) -> None:
    """Take a device through all that needs no clock."""
    for _ in range(UNDISTURBED):
        trial.play("decisions")
    for port in _one_of_each(trial):
        for values in _extremes(trial, port):
            if port in trial.ports():
                trial.play("limits", {port: (encode(trial.message(port, **values)),)})
    for kind in ("bytes", "fields", "source", "ahead", "again", "before"):
        for port in _one_of_each(trial):
            if port in trial.ports():
                trial.play("wrong messages", {port: tuple(_wrong(trial, port, kind))})
                trial.play("wrong messages")
    _replace_neighbours(trial)
    draw = random.Random(seed)
    for _ in range(RANDOM):
        edit = {port: (encode(_random(trial, port, draw)),) for port in trial.ports()}
        trial.play("decisions", edit)


def in_real_time(trial: Trial, seed: int) -> None:
    """Take a device through what comes late or not at all."""
    for _ in range(UNDISTURBED):
        trial.play("decisions")
    units = _units(trial)
    of_plant = [port for port in trial.ports(0) if port.publisher == PLANT]
    for ports in (*units, of_plant):
        trial.play("missing", dict.fromkeys(ports, ()))
        trial.play("missing")
    of_setpoint = [port for port in trial.ports(0) if port.signal.type in (Dispatch, Setpoint)]
    for ports in (*units, of_setpoint):
        for _ in range(trial.plan.hold_cycles + 2):
            trial.play("silent", dict.fromkeys(ports, ()))
        trial.play("silent")
    for ports in units:
        late = {port: (encode(trial.message(port)),) for port in ports if port in trial.ports()}
        trial.play("late", dict.fromkeys(ports, ()), late=late)
        trial.play("late", dict.fromkeys(ports, ()))
        trial.play("late")
    _random_faults(trial, random.Random(seed))


def _random_faults(trial: Trial, draw: random.Random) -> None:
    """Lose, repeat, delay and reorder inputs; something of the plant comes in each cycle."""
    held: dict[Port[Message], tuple[bytes, ...]] = {}
    for _ in range(RANDOM_FAULTS):
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
        trial.play("random faults", edit, late=late)


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
            beyond = trial.plan.cycles if port.publisher == PLANT else cycle
            beyond += trial.plan.periods.longest + 3
            yield encode(trial.message(port, cycle=beyond, **other))
    yield right
    if kind == "again":
        yield encode(trial.message(port, **other))
    if kind == "before":
        yield encode(trial.message(port, cycle=max(cycle - 2, 0), **other))


def _replace_neighbours(trial: Trial) -> None:
    """Let each controller among the publishers be replaced, and its predecessor speak again."""
    for publisher in {port.publisher for port in _one_of_each(trial)} - {PLANT}:
        trial.incarnations[publisher] = trial.cycle
        trial.play("replaced")
        edit = {}
        for port in trial.ports():
            if port.publisher == publisher:
                other_kw = 0.25 * trial.plan.tree.rating_kw(port.node)
                former = trial.message(port, incarnation=0, power_kw=other_kw)
                edit[port] = (encode(former), encode(trial.message(port)))
        trial.play("replaced", edit)


def _random(trial: Trial, port: Port[Message], draw: random.Random) -> Message:
    """Return a message with random numbers within their bounds."""
    rating_kw, kind = trial.plan.tree.rating_kw(port.node), port.signal.type
    if kind not in _RANGES:
        return trial.message(port)
    changes = {"power_kw": draw.uniform(*_RANGES[kind]) * rating_kw}
    if kind is Telemetry:
        changes["alpha"] = draw.choice((1.0, draw.uniform(trial.plan.alpha_min, 1.0)))
        if draw.random() < 0.5:
            changes["available_kw"] = draw.uniform(0.0, 1.04) * rating_kw
    return trial.message(port, **changes)
