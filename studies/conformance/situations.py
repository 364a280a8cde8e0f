"""The situations that a device is put into: what it is sent, cycle by cycle."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from typing import Final, TypeAlias

from msgspec.structs import replace

from agents.cycle import STAGES, kind_of
from agents.device_faults import Copy, DeviceFault
from agents.plan import RunPlan
from bus_schemas.messages import Dispatch, Message, Residual, Setpoint, Telemetry
from bus_schemas.signals import Port
from bus_schemas.tree import PLANT

UNDISTURBED: Final = 5
_RANDOM: Final = 10
"""Cycles of random inputs."""
_RANDOM_FAULTS: Final = 12
"""Cycles in real time in which inputs have random fates."""
_NO_RUN_IS_AS_LONG: Final = 100_000_000
"""Cycles."""
_AWAY_S: Final = 6.0
_MOST_AWAY: Final = 300
"""How long the device may take to be back once it has been killed: seconds, and cycles."""

AWAY: Final = "away"
"""What is shown while the device may be gone: nothing."""

_RIGHT: Final = Copy()
_LOST: Final[tuple[Copy, ...]] = ()

Edit: TypeAlias = Mapping[Port[Message], Sequence[Copy]]
Changes: TypeAlias = dict[str, float | int | str]


class Script:
    """What a device is sent in a launch, and which requirement its answers show in each cycle.

    incarnations: Of the neighbours whose process is to be another than the first one.
    """

    def __init__(self, plan: RunPlan, agent: str, seed: int) -> None:
        self.plan = plan
        self.draw = random.Random(seed)
        self.faults: list[DeviceFault] = []
        self.shows: list[str] = []
        self.incarnations: dict[str, int] = {}
        heard = [port for port in plan.wiring.heard[agent] if port.signal.is_cyclic]
        self.of_plant = [port for port in heard if port.publisher == PLANT]
        # Of several children the first one stands for all.
        self.one_of_each = list({port.signal: port for port in reversed(heard)}.values())
        self.inputs = heard
        wall_ns = plan.timing.cycle_wall_ns or 1
        stages = STAGES[kind_of(agent, plan.tree)]
        first, last = (plan.deadlines.deadline_ns(agent, stages[at]) / wall_ns for at in (0, -1))
        # After the last stage of the cycle, and before the first one of the next.
        self.late, self.held_back = Copy(at=(last + 1.0) / 2.0), Copy(at=1.0 + first / 2.0)

    @property
    def cycle(self) -> int:
        return len(self.shows)

    def due(self, port: Port[Message]) -> bool:
        return self.cycle % self.plan.control.period(port) == 0

    def heard(self) -> list[Port[Message]]:
        """Return the ports of which a message is due in the next cycle."""
        return [port for port in self.inputs if self.due(port)]

    def play(self, requirement: str, edit: Edit | None = None) -> None:
        """Add a cycle, with some messages in place of the right ones of their ports."""
        for port in self.heard():
            copies, joined = (edit or {}).get(port), self.incarnations.get(port.publisher)
            if joined is not None:
                its = (_RIGHT,) if copies is None else copies
                copies = [
                    replace(one, changes={"incarnation": joined} | one.changes) for one in its
                ]
            if copies is not None:
                self.faults.append(DeviceFault(str(port), self.cycle, tuple(copies)))
        self.shows.append(requirement)

    def await_turn(self, requirement: str, port: Port[Message]) -> None:
        """Add cycles up to the next one in which a message of a port is due."""
        while not self.due(port):
            self.play(requirement)

    def lose(self, requirement: str, ports: Sequence[Port[Message]], cycles: int) -> None:
        for _ in range(cycles):
            self.play(requirement, dict.fromkeys(ports, _LOST))

    def undisturbed(self, requirement: str = "decisions") -> None:
        for _ in range(UNDISTURBED):
            self.play(requirement)

    def units(self) -> list[list[Port[Message]]]:
        """Return inputs that stay away together: of the plant each one, of others all."""
        found: dict[str, list[Port[Message]]] = {}
        for port in self.one_of_each:
            name = str(port) if port.publisher == PLANT else port.publisher
            found.setdefault(name, []).append(port)
        return list(found.values())


def in_lockstep(script: Script) -> None:
    """Add all situations that need no clock."""
    script.undisturbed()
    for port in script.one_of_each:
        for changes in _extremes(script.plan, port):
            script.await_turn("limits", port)
            script.play("limits", {port: (Copy(changes),)})
            script.play("limits")  # If such inputs expired, a parent would say nothing.
    for port in script.one_of_each:
        for number in range(len(_wrong(script, port))):
            script.await_turn("wrong messages", port)
            script.play("wrong messages", {port: _wrong(script, port)[number]})
            script.play("wrong messages")
    _replace_neighbours(script)
    for _ in range(_RANDOM):
        script.play("decisions", {port: (_random(script, port),) for port in script.heard()})
    script.play("decisions")


def in_real_time(script: Script) -> None:
    """Add the situations in which inputs come late or not at all."""
    script.undisturbed()
    for ports in (*script.units(), script.of_plant):
        script.lose("missing", ports, 1)
        script.play("missing")
    of_setpoint = [port for port in script.inputs if port.signal.type in (Dispatch, Setpoint)]
    for ports in (*script.units(), of_setpoint):
        script.lose("expired", ports, script.plan.control.hold_cycles + 2)
        script.play("expired")
    for ports in script.units():
        script.await_turn("late", ports[0])
        script.play("late", dict.fromkeys(ports, (script.late,)))
        script.lose("late", ports, 1)
        script.play("late")
    _fault_at_random(script)


def restart(script: Script) -> range:
    """Add cycles in which the device is killed and started again, and those after it."""
    first = script.cycle
    wall_ns = script.plan.timing.cycle_wall_ns
    cycles = min(1 + round(_AWAY_S * 1e9 / wall_ns), _MOST_AWAY)
    script.lose(AWAY, script.inputs, cycles)
    away = range(first, script.cycle)
    script.undisturbed("restart")
    return away


def _replace_neighbours(script: Script) -> None:
    """Let each controller among the publishers be replaced, and its predecessor speak again."""
    for ports in script.units():
        if ports[0].publisher == PLANT:
            continue
        script.await_turn("replaced", ports[-1])
        script.incarnations[ports[0].publisher] = script.cycle
        script.play("replaced")
        script.await_turn("replaced", ports[-1])
        former = {
            port: Copy({"incarnation": 0, "power_kw": _other_kw(script.plan, port)})
            for port in script.heard()
            if port.publisher == ports[0].publisher
        }
        script.play("replaced", {port: (copy, _RIGHT) for port, copy in former.items()})


def _fault_at_random(script: Script) -> None:
    """Lose, repeat, delay and reorder inputs; something of the plant comes in each cycle."""
    fates = {
        "in time": (_RIGHT,),
        "twice": (_RIGHT, _RIGHT),
        "lost": _LOST,
        "late": (script.late,),
        "held back": (script.held_back,),
    }
    for _ in range(_RANDOM_FAULTS):
        unharmed = script.draw.choice(script.of_plant)
        names = ("in time", *fates)
        edit = {port: fates[script.draw.choice(names)] for port in script.heard()}
        script.play("random faults", edit | {unharmed: (_RIGHT,)})
    script.play("random faults")  # What was held back comes.
    script.play("random faults")


def _other_kw(plan: RunPlan, port: Port[Message]) -> float:
    return 0.25 * plan.tree.rating_kw(port.node)


def _extremes(plan: RunPlan, port: Port[Message]) -> list[Changes]:
    """Return fields of an input at and beyond what they can be."""
    rating_kw, kind = plan.tree.rating_kw(port.node), port.signal.type
    above_kw, low_kw = 1.5 * rating_kw, -rating_kw if kind is Residual else 0.0
    values: dict[str, tuple[float | str, ...]] = {
        "power_kw": (low_kw, rating_kw, 3.0 * low_kw - 1.0, above_kw, "nan")
    }
    further: list[Changes] = []
    if kind is Telemetry:
        values["alpha"] = (0.0, 1.5, -0.5, "nan")
        limited: Changes = {"power_kw": 0.3 * rating_kw, "alpha": 0.5}
        stated_kw = 0.9 * rating_kw, above_kw
        further = [{"power_kw": 1.04 * rating_kw, "alpha": 1.0}]
        further += [{**limited, "available_kw": value} for value in stated_kw]
    if kind is Dispatch:
        values["power_kw"] += -500.0, "inf"
        values["plant_rating_kw"] = 0.0, "nan"
    return [*further, *({name: one} for name, its in values.items() for one in its)]


def _wrong(script: Script, port: Port[Message]) -> list[tuple[Copy, ...]]:
    """Return what no sender should send in the next cycle, each with the right message."""
    other_kw, cycle = _other_kw(script.plan, port), script.cycle
    beyond = _NO_RUN_IS_AS_LONG if port.publisher == PLANT else cycle
    beyond += script.plan.control.periods.longest + 3
    damaged = (Copy(damage=damage) for damage in ("empty", "garbage", "cut", "longer", "list"))
    return [
        (*damaged, _RIGHT),
        (Copy(damage="no power"), Copy(damage="no cycle"), _RIGHT),
        (Copy({"source": "nobody", "power_kw": other_kw}), _RIGHT),
        (Copy({"cycle": beyond, "power_kw": other_kw}), _RIGHT),
        (_RIGHT, Copy({"power_kw": other_kw})),
        (_RIGHT, Copy({"cycle": max(cycle - 2, 0), "power_kw": other_kw})),
    ]


def _random(script: Script, port: Port[Message]) -> Copy:
    rating_kw, kind, draw = script.plan.tree.rating_kw(port.node), port.signal.type, script.draw
    ranges = {Dispatch: (-0.2, 1.2), Residual: (-1.0, 1.0), Telemetry: (0.0, 1.1)}
    changes: Changes = {"power_kw": draw.uniform(*ranges.get(kind, (0.0, 1.0))) * rating_kw}
    if kind is Telemetry:
        changes["alpha"] = draw.choice((1.0, draw.uniform(script.plan.control.alpha_min, 1.0)))
        if draw.random() < 0.5:
            changes["available_kw"] = draw.uniform(0.0, 1.1) * rating_kw
    return Copy(changes)
