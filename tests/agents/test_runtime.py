"""How a process takes its agent through a run in real time, on a bus that is not there."""

from __future__ import annotations

import time
from collections import Counter
from typing import cast

import pytest
from msgspec.structs import replace
from plants_by_hand import CYCLE_NS, plan_of

from agents.lifeline import Event, Lifeline
from agents.plan import RunPlan
from agents.runtime import DropLog, Runtime
from agents.team import Controller, central_controller, direct_controller, supervisor
from bus_schemas.bus import Arrival
from bus_schemas.messages import Message, Telemetry
from bus_schemas.missing import skipped_cycles
from bus_schemas.signals import COMMAND, IMPP, REQUEST, SETPOINT, TELEMETRY, Port, Signal
from bus_schemas.zenoh_bus import ZenohBus

CYCLES = 100
PLAN = replace(
    plan_of({"c1/a": 100.0, "c1/b": 100.0}, cycles=CYCLES), cycle_wall_ns=CYCLE_NS, late="use"
)


class QuietBus:
    """Keeps what is published, and brings what it is given; nobody waits for anything."""

    def __init__(self) -> None:
        self.sent: list[tuple[Port[Message], Message]] = []
        self.to_come: list[Arrival] = []
        self.undecodable = self.unknown = self.flooded = 0
        self.publishing = None
        self.published: Counter[str] = Counter()

    def publish(self, port: Port[Message], message: Message) -> None:
        self.sent.append((port, message))

    def receive(self, wanted: int, timeout_s: float | None) -> list[Arrival]:
        arrivals, self.to_come = self.to_come, []
        return arrivals

    def cycles(self, signal: Signal[Message]) -> list[int]:
        """Cycles of the messages of a signal, in their order."""
        return [message.cycle for port, message in self.sent if port.signal is signal]


class QuietLine(Lifeline):
    """Nobody holds the other end."""

    def __init__(self) -> None:
        super().__init__(attached=False)

    def tell(self, event: Event) -> None:
        pass


def runtime_of(agent: Controller, plan: RunPlan = PLAN) -> tuple[Runtime[object], QuietBus]:
    bus = QuietBus()
    return Runtime(agent, plan, cast(ZenohBus, bus), QuietLine(), DropLog()), bus


def after(cycles: float) -> int:
    """When cycle 0 began, if so many cycles have passed since."""
    return time.monotonic_ns() - round(cycles * CYCLE_NS)


def telemetry(cycle: int) -> Arrival:
    message = Telemetry(
        cycle, cycle * CYCLE_NS, "plant", (), power_kw=40.0, alpha=0.5, limit_kw=100.0
    )
    return Arrival(TELEMETRY.of("c1/a"), message, time.monotonic_ns())


def test_a_process_that_stood_still_comes_back_to_the_cycle_under_way() -> None:
    runtime, bus = runtime_of(direct_controller(PLAN, "c1/a"))
    runtime.begin(after(60.05))
    bus.to_come = [telemetry(cycle) for cycle in range(61)]
    runtime.turn()
    assert runtime.sequencer.cycle == 60
    assert runtime.sequencer.skipped_cycles == 60
    assert bus.sent == [], "what nobody can use any more is not sent"
    assert runtime.sequencer.waiting_for == {REQUEST.of("c1/a")}, "telemetry of cycle 60 is there"
    assert runtime.sequencer.drops.late == 60


def test_its_first_word_then_says_what_it_gave_up() -> None:
    runtime, bus = runtime_of(direct_controller(PLAN, "c1/a"))
    runtime.begin(after(60.95))
    for _ in range(3):
        runtime.turn()
    assert bus.cycles(IMPP) == bus.cycles(COMMAND) == [60]
    _, first = bus.sent[0]
    assert skipped_cycles(first.missing, first.cycle) == range(60)


@pytest.mark.parametrize("behind", [0.5, 1.5])
def test_a_process_that_is_a_little_late_skips_nothing(behind: float) -> None:
    runtime, bus = runtime_of(direct_controller(PLAN, "c1/a"))
    runtime.begin(after(behind))
    for _ in range(3):
        runtime.turn()
    assert runtime.sequencer.skipped_cycles == 0
    assert bus.cycles(IMPP)[:1] == [0]


RARELY = replace(PLAN, period_cycles=(60, 10))


@pytest.mark.parametrize(
    ("agent", "turn"), [(central_controller(RARELY), 60), (supervisor(RARELY, "c1"), 70)]
)
def test_the_last_turn_of_who_acts_rarely_is_not_given_up(agent: Controller, turn: int) -> None:
    runtime, bus = runtime_of(agent, RARELY)
    runtime.begin(after(73.05))
    for _ in range(9):
        runtime.turn()
    assert bus.cycles(REQUEST)[0] == bus.cycles(SETPOINT)[0] == turn
    assert runtime.sequencer.cycle == 73


def test_a_turn_that_is_under_way_is_brought_to_its_end() -> None:
    runtime, bus = runtime_of(central_controller(RARELY), RARELY)
    runtime.begin(after(0.0))
    runtime.begin(after(13.05))  # it stood still from its first moment on
    for _ in range(4):
        runtime.turn()
    assert bus.cycles(SETPOINT) == [0]
    assert runtime.sequencer.cycle == 13
