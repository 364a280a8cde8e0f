"""What a process in real time says of itself while it runs and at its end."""

from __future__ import annotations

import gc
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import cast

import pytest
from msgspec.structs import replace
from plants_by_hand import plan_of

from agents.lifeline import Event, Finished, Lifeline
from agents.plan import RunPlan
from agents.runtime import DropLog, Runtime
from agents.team import central_controller, direct_controller
from bus_schemas.bus import Arrival
from bus_schemas.messages import Message, Request, Setpoint, Telemetry, Timing
from bus_schemas.signals import REQUEST, SETPOINT, TELEMETRY, TIMING, Port
from bus_schemas.tree import CENTRAL, ROOT
from bus_schemas.zenoh_bus import ZenohBus

MS = 1_000_000
NODE = "c1/a"
PLAN = replace(
    plan_of({NODE: 100.0, "c1/b": 100.0}, cycles=1_000_000), cycle_wall_ns=20 * MS, late="drop"
)


class FedBus:
    """Brings what it is given, and else waits for as long as the process would."""

    def __init__(self) -> None:
        self.sent: list[tuple[Port[Message], Message, int]] = []
        self.to_come: list[Arrival] = []
        self.undecodable = self.unknown = self.flooded = 0
        self.publishing = None
        self.published: Counter[str] = Counter()
        self.keeps = True

    def publish(self, port: Port[Message], message: Message) -> None:
        if self.keeps:
            self.sent.append((port, message, time.monotonic_ns()))

    def receive(self, wanted: int, timeout_s: float | None) -> list[Arrival]:
        if not self.to_come:
            time.sleep(timeout_s or 0.0)
        arrivals, self.to_come = self.to_come, []
        return arrivals

    def timings(self) -> list[tuple[Port[Message], Timing, int]]:
        return [
            (port, message, when) for port, message, when in self.sent if type(message) is Timing
        ]


class KeptLine(Lifeline):
    """Keeps what is told."""

    def __init__(self) -> None:
        super().__init__(attached=False)
        self.told: list[Event] = []

    def tell(self, event: Event) -> None:
        self.told.append(event)


def process_of(agent: object, plan: RunPlan = PLAN) -> tuple[Runtime[object], FedBus, KeptLine]:
    bus, line = FedBus(), KeptLine()
    runtime: Runtime[object] = Runtime(agent, plan, cast(ZenohBus, bus), line, DropLog())  # type: ignore[arg-type]
    return runtime, bus, line


@pytest.fixture
def collector() -> Iterator[None]:
    yield
    gc.enable()
    gc.unfreeze()


def run_for(runtime: Runtime[object], wall_s: float) -> None:
    end = time.monotonic() + wall_s
    while time.monotonic() < end:
        runtime.turn()


def test_counts_go_out_once_a_second_at_most_and_at_the_end() -> None:
    runtime, bus, line = process_of(direct_controller(PLAN, NODE))
    runtime.begin(time.monotonic_ns())
    run_for(runtime, 2.5)  # Nobody says anything: each stage closes at its deadline.
    moments = [when for *_, when in bus.timings()]
    assert 1 <= len(moments) <= 3
    assert all(later - earlier > 900 * MS for earlier, later in pairwise(moments))
    runtime.report()
    (finished,) = line.told
    assert isinstance(finished, Finished)
    assert finished.timing is not None
    ports = {port for port, *_ in bus.timings()}
    assert ports == {TIMING.of(NODE)}
    _, last, _ = bus.timings()[-1]
    assert last.missed_deadlines == sum(finished.timing.missed_deadlines.values()) > 50
    assert last.missing_inputs == sum(finished.timing.missing_inputs.values())
    assert set(finished.timing.missed_deadlines) == {"estimate", "actuate"}
    assert set(finished.timing.missing_inputs) == {
        f"{NODE}/{name}" for name in ("telemetry", "request", "setpoint")
    }


def test_the_central_controller_speaks_about_the_root() -> None:
    runtime, bus, _ = process_of(central_controller(PLAN))
    runtime.begin(time.monotonic_ns())
    run_for(runtime, 0.1)
    runtime.report()
    ((port, message, _),) = bus.timings()
    assert (port, message.source) == (TIMING.of(ROOT), CENTRAL)


def test_in_lockstep_there_is_nothing_to_say() -> None:
    plan = replace(PLAN, cycle_wall_ns=0)
    runtime, bus, line = process_of(direct_controller(plan, NODE), plan)
    runtime.begin(0)
    for cycle in range(5):
        feed(bus, cycle)
        runtime.turn(0.0)
    runtime.report()
    (finished,) = line.told
    assert isinstance(finished, Finished)
    assert finished.timing is None
    assert bus.timings() == []
    assert len(bus.sent) >= 5 * 3


def test_a_process_that_is_never_idle_does_not_note_moments_without_end() -> None:
    runtime, bus, _ = process_of(direct_controller(PLAN, NODE))
    runtime.begin(time.monotonic_ns())
    stopwatch = runtime._stopwatch
    assert stopwatch is not None
    for number in range(6_000):
        feed(bus, number // 10)
        runtime.turn()
        assert len(stopwatch._arrivals) <= 5_010


def feed(bus: FedBus, cycle: int) -> None:
    now_ns = time.monotonic_ns()
    head = {"publish_time_ns": now_ns, "sequence": cycle}
    said: list[tuple[Port[Message], Message]] = [
        (
            TELEMETRY.of(NODE),
            Telemetry(cycle, 0, "plant", (), **head, power_kw=40.0, alpha=1.0, limit_kw=100.0),
        ),
        (REQUEST.of(NODE), Request(cycle, 0, "c1", (), **head, power_kw=30.0)),
        (
            SETPOINT.of(NODE),
            Setpoint(cycle, 0, "c1", (), **head, power_kw=30.0, share_kw=30.0, help_given=()),
        ),
    ]
    bus.to_come = [Arrival(port, message, now_ns) for port, message in said]


@pytest.mark.usefixtures("collector")
def test_thousands_of_cycles_leave_nothing_behind_though_nothing_is_collected() -> None:
    """Memory after 3,000 cycles is that after 1,000: nothing in the loop grows, nor makes cycles
    of references that only the collector could free.
    """
    # Cycles of an hour: no deadline passes, and the moments are settled by hand.
    plan = replace(PLAN, cycle_wall_ns=3_600_000 * MS)
    runtime, bus, _ = process_of(direct_controller(plan, NODE), plan)
    runtime.begin(time.monotonic_ns())
    bus.keeps = False
    settle: Callable[[], None] = runtime._stopwatch.settle  # type: ignore[union-attr]
    gc.collect()
    gc.freeze()
    gc.disable()
    held: list[int] = []
    tracemalloc.start()
    try:
        for cycle in range(3_000):
            feed(bus, cycle)
            runtime.turn()
            if cycle % 1_000 == 999:
                settle()
                held.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert runtime.sequencer.cycle == 3_000
    assert held[-1] - held[0] < 5_000
