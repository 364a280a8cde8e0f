"""A controller that is late, or never answers, stops nobody else; and what it says is not lost."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.faults import FaultRule
from bus_schemas.messages import Message
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, PRODUCTION, SETPOINT, Port, Signal
from bus_schemas.tree import ROOT
from launch_scripts.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenario import load_scenario
from launch_scripts.timed_simulation import TimedRun, on_the_clock

CYCLES = 75
SECOND_NS = 1_000_000_000
DEADLINES_NS = (400_000_000, 500_000_000, 600_000_000, 700_000_000)


@pytest.fixture(scope="module")
def prepared() -> Preparation:
    """Four tiers: the central controller acts once a minute, those below it every ten seconds."""
    whole = prepare(load_scenario("valley"), RunOptions(duration=f"{CYCLES}s"), "by-hand")
    plan = on_the_clock(replace(whole.plan, period_cycles=(60, 10, 1)))
    return Preparation(plan, whole.profile, whole.scenario, whole.hindsight, whole.remarks)


def run(prepared: Preparation, *rules: FaultRule, **changes: object) -> tuple[TimedRun, Said]:
    plan = replace(prepared.plan, faults=rules, **changes)
    said = Said()
    timed_run = TimedRun(plan, prepared.profile, said)
    assert list(timed_run.cycles()) == list(range(plan.cycles))
    return timed_run, said


class Said:
    """All that was said."""

    def __init__(self) -> None:
        self.messages: list[Delivery] = []

    def __call__(self, port: Port[Message], message: Message) -> None:
        self.messages.append((port, message))

    def of(self, signal: Signal[Message], node: str) -> dict[int, Message]:
        """Each cycle's message of a signal about a node."""
        port = signal.of(node)
        return {message.cycle: message for said_on, message in self.messages if said_on is port}


def missing_inputs(timed_run: TimedRun) -> int:
    return sum(sequencer.missing_inputs for sequencer in timed_run.sequencers.values())


def late_used(timed_run: TimedRun) -> int:
    return sum(sequencer.late_used for sequencer in timed_run.sequencers.values())


@pytest.mark.parametrize("tier_deadlines_ns", [(), DEADLINES_NS])
def test_tiers_that_act_rarely_meet_their_deadlines_in_their_turns(
    prepared: Preparation, tier_deadlines_ns: tuple[int, ...]
) -> None:
    timed_run, said = run(prepared, FaultRule(delay_ms=50.0), tier_deadlines_ns=tier_deadlines_ns)
    assert missing_inputs(timed_run) == 0
    upper = prepared.plan.tree.children(ROOT)[0]
    lower = prepared.plan.tree.children(upper)[0]
    leaf = prepared.plan.tree.children(lower)[0]
    assert list(said.of(SETPOINT, upper)) == [0, 60]
    assert list(said.of(SETPOINT, lower)) == list(range(0, CYCLES, 10))
    assert list(said.of(SETPOINT, leaf)) == list(range(CYCLES))
    assert list(said.of(COMMAND, leaf)) == list(range(CYCLES))


def test_what_a_central_controller_says_after_its_deadline_counts_from_the_next_turn_on(
    prepared: Preparation,
) -> None:
    slow = FaultRule(source="central", delay_ms=2_500.0)
    timed_run, said = run(prepared, slow)
    upper = prepared.plan.tree.children(ROOT)[0]
    lower = prepared.plan.tree.children(upper)[0]
    targets = said.of(SETPOINT, lower)
    # Said in cycle 60, heard in cycle 63, and divided in the supervisor's turn in cycle 70.
    assert targets[60].missing == (f"{upper}/request", f"{upper}/setpoint")
    assert targets[70].missing == (f"{upper}/request@60", f"{upper}/setpoint@60")
    assert timed_run.sequencers["central"].drops.total() == 0
    # Dropped, it would not count for a whole minute.
    dropping, _ = run(prepared, slow, late="drop")
    children = len(prepared.plan.tree.children(ROOT))
    # Request and setpoint, of cycles 0 and 60.
    assert [late_used(each) for each in (timed_run, dropping)] == [4 * children, 0]


@pytest.mark.parametrize("silent", ["central", "z1/c1"])
@pytest.mark.parametrize("period_cycles", [(1, 1, 1), (60, 10, 1)])
def test_everybody_goes_on_without_a_controller_that_never_answers(
    prepared: Preparation, silent: str, period_cycles: tuple[int, ...]
) -> None:
    rule = FaultRule(source=silent, loss=1.0)
    _, said = run(prepared, rule, period_cycles=period_cycles, tier_deadlines_ns=DEADLINES_NS)
    plan = prepared.plan
    for leaf in plan.tree.leaves:
        commands = said.of(COMMAND, leaf)
        assert list(commands) == list(range(CYCLES))
        assert in_time(plan, commands, DEADLINES_NS[-1])
    for node in plan.tree.parents:
        assert list(said.of(IMPP, node)) == list(range(CYCLES))
    assert list(said.of(DISPATCH, ROOT)) == list(said.of(PRODUCTION, ROOT)) == list(range(CYCLES))
    ticks_ns = [message.publish_time_ns for message in said.of(DISPATCH, ROOT).values()]
    assert ticks_ns == [cycle * SECOND_NS for cycle in range(CYCLES)]


def in_time(plan: RunPlan, said: dict[int, Message], deadline_ns: int) -> bool:
    return all(
        message.publish_time_ns <= cycle * plan.cycle_wall_ns + deadline_ns
        for cycle, message in said.items()
    )
