"""What a process in real time says of itself while it runs and at its end."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Iterator

import pytest
from msgspec.structs import replace
from plants_by_hand import plan_of
from processes_by_hand import ProcessByHand

from agents.events import Finished
from agents.team import central_controller, direct_controller
from bus_schemas.bus import Arrival
from bus_schemas.messages import Message, Request, Setpoint, Telemetry, Timing
from bus_schemas.signals import (
    COMMAND,
    IMPP,
    REQUEST,
    RESIDUAL,
    SETPOINT,
    TELEMETRY,
    TIMING,
    Port,
)
from bus_schemas.tree import CENTRAL, ROOT

MS = 1_000_000
NODE = "c1/a"
PLAN = replace(
    plan_of({NODE: 100.0, "c1/b": 100.0}, cycles=1_000_000), cycle_wall_ns=20 * MS, late="drop"
)


@pytest.fixture
def collector() -> Iterator[None]:
    yield
    gc.enable()
    gc.unfreeze()


def test_counts_go_out_once_a_second_at_most_and_at_the_end() -> None:
    process = ProcessByHand(direct_controller(PLAN, NODE), PLAN)
    process.begin()
    process.run_for(2.5)  # Nobody says anything: each stage closes at its deadline.
    process.runtime.report()
    # First after its last deadline of cycle 0, at 0.9 x 7 of 8 slices; then 50 cycles later.
    assert process.into_cycles() == pytest.approx([0.7875, 50.7875, 100.7875, 125.0])
    assert {port for port, message, _ in process.bus.sent if isinstance(message, Timing)} == {
        TIMING.of(NODE)
    }
    (finished,) = process.line.told
    assert isinstance(finished, Finished)
    assert finished.timing is not None
    assert finished.timing.missed_deadlines == {"estimate": 125, "actuate": 125}
    assert finished.timing.missing_inputs == {
        f"{NODE}/{name}": 125 for name in ("telemetry", "request", "setpoint")
    }
    assert [message.missed_deadlines for message in process.bus.timings()] == [2, 102, 202, 250]
    assert process.bus.timings()[-1].counts == (250, 375, 0, 0, 0)


def test_what_found_no_room_is_named_by_key() -> None:
    process = ProcessByHand(direct_controller(PLAN, NODE), PLAN)
    process.begin()
    feed(process, 0)
    process.runtime.turn()
    feed(process, 0)
    process.runtime.turn()
    process.bus.flooded.update({f"{NODE}/setpoint": 9_000, f"{NODE}/telemetry": 20})
    process.runtime.report()
    (finished,) = process.line.told
    assert isinstance(finished, Finished)
    assert finished.dropped == {"late": 3, "flooded": 9_020}
    assert finished.dropped_ports[f"{NODE}/setpoint"] == {"late": 1, "flooded": 9_000}
    assert finished.dropped_ports[f"{NODE}/telemetry"] == {"late": 1, "flooded": 20}


def test_what_has_not_changed_is_not_said_again() -> None:
    process = ProcessByHand(direct_controller(PLAN, NODE), PLAN)
    process.begin()
    process.run_for(0.02)
    process.runtime.report()
    assert process.into_cycles() == pytest.approx([0.7875])


def test_the_central_controller_speaks_about_the_root() -> None:
    process = ProcessByHand(central_controller(PLAN), PLAN)
    process.begin()
    process.run_for(0.1)
    process.runtime.report()
    said = [sent for sent in process.bus.sent if isinstance(sent.message, Timing)]
    assert {(port, message.source) for port, message, _ in said} == {(TIMING.of(ROOT), CENTRAL)}
    # Third of six, its moment of its own is 2 / 6 of the way from 0.5 to 0.9 of the cycle.
    assert process.into_cycles() == pytest.approx([0.5 + 0.4 * 2 / 6, 5.0])


def test_in_lockstep_there_is_nothing_to_say() -> None:
    plan = replace(PLAN, cycle_wall_ns=0)
    process = ProcessByHand(direct_controller(plan, NODE), plan)
    process.begin()
    for cycle in range(5):
        feed(process, cycle)
        process.runtime.turn(0.0)
    process.runtime.report()
    (finished,) = process.line.told
    assert isinstance(finished, Finished)
    assert finished.timing is None
    assert process.bus.timings() == []
    assert [process.bus.cycles(signal) for signal in (IMPP, RESIDUAL, COMMAND)] == [[*range(5)]] * 3


def test_a_process_that_is_never_idle_does_not_note_moments_without_end() -> None:
    process = ProcessByHand(direct_controller(PLAN, NODE), PLAN)
    process.begin()
    stopwatch = process.runtime._stopwatch
    assert stopwatch is not None
    most = 0
    for number in range(6_000):
        # It hears of each cycle ten times, and all the while there is more to hear.
        feed(process, number // 10)
        process.runtime.turn()
        process.clock.now_ns += 2 * MS
        most = max(most, stopwatch.noted)
    assert process.runtime.sequencer.cycle == 600
    assert 3_000 < most <= 5_000, "of 18,000 arrivals and 3,600 others"


def feed(process: ProcessByHand, cycle: int) -> None:
    now_ns = process.clock.now_ns
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
    process.bus.to_come = [Arrival(port, message, now_ns) for port, message in said]


@pytest.mark.usefixtures("collector")
def test_thousands_of_cycles_leave_nothing_behind_though_nothing_is_collected() -> None:
    """Memory after 3,000 cycles is that after 1,000: nothing in the loop grows, nor makes cycles
    of references that only the collector could free.
    """
    # Cycles of an hour: no deadline passes, and the moments are settled by hand.
    plan = replace(PLAN, cycle_wall_ns=3_600_000 * MS)
    process = ProcessByHand(direct_controller(plan, NODE), plan)
    process.begin()
    process.bus.keeps = False
    stopwatch = process.runtime._stopwatch
    assert stopwatch is not None
    gc.collect()
    gc.freeze()
    gc.disable()
    held: list[int] = []
    tracemalloc.start()
    try:
        for cycle in range(3_000):
            feed(process, cycle)
            process.runtime.turn()
            process.clock.now_ns += MS
            if cycle % 1_000 == 999:
                stopwatch.settle()
                held.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert process.runtime.sequencer.cycle == 3_000
    assert held[-1] - held[0] < 5_000
