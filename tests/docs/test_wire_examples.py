"""The examples of docs/wire.md are what our own controller does."""

from __future__ import annotations

import json
import re
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import pytest
from plans_by_hand import plan_at_noon

from agents.driver import Driver
from agents.loop import Loop
from agents.plan import RunPlan
from agents.team import controller
from bus_schemas.bus import Arrival
from bus_schemas.messages import Command, Dispatch, Impp, Message, Setpoint, Telemetry
from bus_schemas.signals import DISPATCH, SETPOINT, TELEMETRY, Port
from bus_schemas.tree import PLANT, ROOT

NODE = "c2/inv07"
WIRE = (Path(__file__).parents[2] / "docs" / "wire.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^(\d) (\[.*?\]): (.*)\n  -> (.*)$", WIRE, re.MULTILINE)
START_NS, CYCLE_NS = 5_000_000_000, 1_000_000_000


def message(plan: RunPlan, signal: str, cycle: int) -> tuple[Port[Message], Message]:
    """What the page says that each message is."""
    head = cycle, plan.timing.sim_time_ns(cycle)
    if signal == "dispatch":
        return DISPATCH.of(ROOT), Dispatch(
            *head,
            PLANT,
            (),
            power_kw=100.0,
            plant_rating_kw=200.0,
            commitment_kw=100.0,
            regulation_kw=0.0,
        )
    if signal == "telemetry":
        its = Telemetry(*head, PLANT, (), power_kw=80.0, alpha=1.0, limit_kw=100.0)
        return TELEMETRY.of(NODE), its
    setpoint = Setpoint(*head, "c2", (), power_kw=40.0, share_kw=50.0, help_given=())
    return SETPOINT.of(NODE), setpoint


class Sent:
    """A bus on which the inputs of an example arrive at their times."""

    def __init__(self, plan: RunPlan, inputs: str) -> None:
        self.messages: list[tuple[Port[Message], Message]] = []
        self.now_ns = START_NS
        self._left = deque(
            Arrival(NODE, *message(plan, signal, int(cycle)), self._time_ns(float(at)))
            for signal, cycle, at in re.findall(r"(\w+)@(\d+) ([\d.]+)", inputs)
        )
        loop = Loop(controller(plan, NODE), plan)
        loop.begin(START_NS, START_NS, 0)
        for _ in Driver([loop], self, lambda: self.now_ns).run():
            if not self._left and self.now_ns > self._time_ns(plan.timing.cycles - 1.0):
                return

    def _time_ns(self, cycles: float) -> int:
        return START_NS + round(cycles * CYCLE_NS)

    def publish(self, port: Port[Message], its: Message, now_ns: int) -> None:
        self.messages.append((port, its))

    def receive(self, until_ns: int | None, wanted: int = 1) -> Sequence[Arrival]:
        if self._left and (until_ns is None or self._left[0].time_ns <= until_ns):
            arrival = self._left.popleft()
            self.now_ns = max(self.now_ns, arrival.time_ns)
            return (arrival,)
        self.now_ns = max(self.now_ns, until_ns or 0)
        return ()


def in_words(its: Message) -> str:
    missing = f" missing {', '.join(its.missing)}" if its.missing else ""
    if isinstance(its, Impp):
        return f"impp@{its.cycle} stale {its.stale_cycles}{missing}"
    assert isinstance(its, Command)
    return f"command@{its.cycle} {its.power_kw:g} kW{missing}"


@pytest.mark.parametrize(("number", "periods", "inputs", "outputs"), EXAMPLES)
def test_our_controller_does_what_the_examples_say(
    number: str, periods: str, inputs: str, outputs: str
) -> None:
    cycles = 1 + max(int(cycle) for cycle in re.findall(r"@(\d+) [\d.]", inputs))
    plan = plan_at_noon(
        {NODE: 100.0, "c2/inv08": 100.0},
        cycles=cycles,
        cycle_wall_ns=CYCLE_NS,
        period_cycles=tuple(json.loads(periods)),
        hold_cycles=2,
        scheme="paper",
        actuator="limit",
    )
    sent = Sent(plan, inputs).messages
    published = {in_words(its) for _, its in sent if isinstance(its, Impp | Command)}
    expected = outputs.split(", ")
    assert set(expected) <= published, published
    signals = {(port.signal.name, its.cycle) for port, its in sent}
    if number == "5":
        assert ("command", 0) not in signals


def test_there_is_an_example_for_each_of_the_five_questions() -> None:
    assert [number for number, *_ in EXAMPLES] == ["1", "2", "3", "4", "5"]
