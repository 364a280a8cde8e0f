"""How a process takes its agent through a run in real time, on a bus that is not there."""

from __future__ import annotations

import logging

import pytest
from msgspec.structs import replace
from plants_by_hand import CYCLE_NS, plan_of
from processes_by_hand import ProcessByHand

from agents.team import Controller, central_controller, direct_controller, supervisor
from bus_schemas.bus import Arrival
from bus_schemas.messages import Run, Telemetry
from bus_schemas.missing import skipped_cycles
from bus_schemas.signals import COMMAND, IMPP, REQUEST, RUN, SETPOINT, TELEMETRY
from bus_schemas.tree import PLANT, ROOT

CYCLES = 100
PLAN = replace(
    plan_of({"c1/a": 100.0, "c1/b": 100.0}, cycles=CYCLES), cycle_wall_ns=CYCLE_NS, late="use"
)


def telemetry(cycle: int) -> Arrival:
    message = Telemetry(
        cycle, cycle * CYCLE_NS, "plant", (), power_kw=40.0, alpha=0.5, limit_kw=100.0
    )
    return Arrival(TELEMETRY.of("c1/a"), message, 1)


def test_a_process_that_stood_still_comes_back_to_the_cycle_under_way() -> None:
    process = ProcessByHand(direct_controller(PLAN, "c1/a"), PLAN)
    process.begin(cycles_ago=60.05)
    process.bus.to_come = [telemetry(cycle) for cycle in range(61)]
    process.runtime.turn()
    sequencer = process.runtime.sequencer
    assert sequencer.cycle == 60
    assert sequencer.skipped_cycles == 60
    assert process.bus.sent == [], "what nobody can use any more is not sent"
    assert sequencer.waiting_for == {REQUEST.of("c1/a")}, "telemetry of cycle 60 is there"
    assert sequencer.drops.late == 60


def test_its_first_word_then_says_what_it_gave_up() -> None:
    process = ProcessByHand(direct_controller(PLAN, "c1/a"), PLAN)
    process.begin(cycles_ago=60.95)
    process.run_for(0.05)
    assert process.bus.cycles(IMPP) == process.bus.cycles(COMMAND) == [60]
    _, first, said_ns = process.bus.sent[0]
    assert said_ns == process.start_ns, "at once: its deadlines are over"
    assert skipped_cycles(first.missing, first.cycle) == range(60)


@pytest.mark.parametrize("behind", [0.5, 1.5])
def test_a_process_that_is_a_little_late_skips_nothing(behind: float) -> None:
    process = ProcessByHand(direct_controller(PLAN, "c1/a"), PLAN)
    process.begin(cycles_ago=behind)
    process.run_for(2.0 - behind)
    assert process.runtime.sequencer.skipped_cycles == 0
    assert process.bus.cycles(IMPP) == process.bus.cycles(COMMAND) == [0, 1]


RARELY = replace(PLAN, period_cycles=(60, 10))


@pytest.mark.parametrize(
    ("agent", "turn"), [(central_controller(RARELY), 60), (supervisor(RARELY, "c1"), 70)]
)
def test_the_last_turn_of_who_acts_rarely_is_not_given_up(agent: Controller, turn: int) -> None:
    process = ProcessByHand(agent, RARELY)
    process.begin(cycles_ago=73.05)
    process.run_for(0.95)
    assert process.bus.cycles(REQUEST)[0] == process.bus.cycles(SETPOINT)[0] == turn
    assert process.bus.sent[0].time_ns == process.start_ns, "late, but at once"
    assert process.runtime.sequencer.cycle == 74


def test_a_turn_that_is_under_way_is_brought_to_its_end() -> None:
    process = ProcessByHand(central_controller(RARELY), RARELY)
    process.begin()
    process.begin(cycles_ago=13.05)  # it stood still from its first moment on
    process.run_for(0.95)
    assert process.bus.cycles(SETPOINT) == [0]
    assert process.runtime.sequencer.cycle == 14


def start(process: ProcessByHand, start_ns: int, cycle_wall_ns: int = CYCLE_NS) -> None:
    """Let the plant's word come in that the run begins."""
    message = Run(
        0, 0, PLANT, (), state="start", start_time_ns=start_ns, cycle_wall_ns=cycle_wall_ns
    )
    process.bus.to_come = [Arrival(RUN.of(ROOT), message, process.clock.now_ns)]
    process.runtime.turn()


@pytest.mark.parametrize("ahead_s", [-11.0, 11.0, 1e9])
def test_a_beginning_by_another_clock_is_when_the_word_of_it_comes(
    ahead_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    process = ProcessByHand(direct_controller(PLAN, "c1/a"), PLAN)
    process.clock.now_ns += 600 * CYCLE_NS
    process.start_ns = process.clock.now_ns
    with caplog.at_level(logging.WARNING):
        start(process, process.start_ns + round(ahead_s * 1e9))
        process.run_for(3.5)
    assert process.runtime.sequencer.skipped_cycles == 0
    assert process.bus.cycles(IMPP) == [0, 1, 2, 3]
    assert process.into_cycles()[0] < 1.0
    (record,) = [record for record in caplog.records if "cycle 0 begins now" in record.message]
    assert "start_time_ns is" in record.message


@pytest.mark.parametrize("ahead_s", [-1.5, 0.2, 3.0])
def test_a_beginning_that_is_near_is_as_the_plant_says(
    ahead_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    process = ProcessByHand(direct_controller(PLAN, "c1/a"), PLAN)
    begins_ns = process.start_ns + round(ahead_s * 1e9)
    with caplog.at_level(logging.WARNING):
        start(process, begins_ns)
        process.run_for(6.0)
    first = process.bus.sent[0]
    assert first.time_ns == max(begins_ns + CYCLE_NS * 9 // 10 * 3 // 8, process.start_ns)
    assert not [record for record in caplog.records if "begins" in record.message]


def test_in_mid_run_a_second_beginning_changes_nothing() -> None:
    one, other = (ProcessByHand(direct_controller(PLAN, "c1/a"), PLAN) for _ in range(2))
    for process in (one, other):
        start(process, process.start_ns)
        process.run_for(5.25)
    start(other, other.clock.now_ns + 2 * CYCLE_NS)
    for process in (one, other):
        process.run_for(4.0)
    assert [(sent.port, sent.time_ns) for sent in one.bus.sent] == [
        (sent.port, sent.time_ns) for sent in other.bus.sent
    ]


def test_cycles_of_another_length_than_the_plans_are_named(
    caplog: pytest.LogCaptureFixture,
) -> None:
    process = ProcessByHand(direct_controller(PLAN, "c1/a"), PLAN)
    with caplog.at_level(logging.WARNING):
        start(process, process.start_ns, cycle_wall_ns=CYCLE_NS // 2)
        process.run_for(3.0)
    assert f"cycles last {CYCLE_NS // 2} ns" in caplog.text
    assert process.bus.cycles(COMMAND) == [0, 1, 2]
