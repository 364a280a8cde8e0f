"""A plant on a virtual clock: as in lockstep over a good network, repeatable over a bad one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from agents.plan import RunPlan
from bus_schemas.codec import encode
from bus_schemas.faults import FaultRule
from bus_schemas.messages import Message, Production
from bus_schemas.signals import COMMAND, IMPP, PRODUCTION, RUN, TELEMETRY, Port
from bus_schemas.tree import PLANT, ROOT
from launch_scripts.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenario import load_scenario
from launch_scripts.simulation import MemoryRun
from launch_scripts.timed_simulation import TimedRun, on_the_clock
from sim_plant.profile import Profile

CYCLES = 40
SECOND_NS = 1_000_000_000
MS = 1_000_000


class Told:
    """All that is said in a run, in its order."""

    def __init__(self) -> None:
        self.messages: list[tuple[Port[Message], Message]] = []

    def __call__(self, port: Port[Message], message: Message) -> None:
        self.messages.append((port, message))

    def decisions(self) -> dict[tuple[str, int], Message]:
        """What was decided, by port and cycle: without publish times, and without `run`."""
        return {
            (str(port), message.cycle): replace(message, publish_time_ns=0)
            for port, message in self.messages
            if port.signal is not RUN
        }

    def of(self, port: Port[Message]) -> dict[int, Message]:
        return {message.cycle: message for said_on, message in self.messages if said_on is port}

    def bytes(self) -> list[bytes]:
        return [encode(message) for _, message in self.messages]


@pytest.fixture(scope="module")
def prepared() -> Preparation:
    return prepare(load_scenario("valley"), RunOptions(duration=f"{CYCLES}s"), "by-hand")


def timed(
    prepared: Preparation, rules: Sequence[FaultRule], **changes: object
) -> tuple[TimedRun, Told]:
    """Run through; every run says that it is over."""
    plan = replace(on_the_clock(prepared.plan), faults=tuple(rules), **changes)
    told = Told()
    run = TimedRun(plan, prepared.profile, told)
    assert list(run.cycles()) == list(range(plan.cycles))
    run.close()
    return run, told


def in_lockstep(prepared: Preparation, plan: RunPlan) -> Told:
    told = Told()
    for _ in MemoryRun(plan, prepared.profile, told).cycles():
        pass
    return told


@pytest.mark.parametrize("scheme", ["paper", "predictive"])
@pytest.mark.parametrize("longest_period", [1, 6])
def test_over_a_perfect_network_the_decisions_are_those_of_lockstep_bit_for_bit(
    prepared: Preparation, scheme: str, longest_period: int
) -> None:
    tiers = len(prepared.plan.period_cycles)
    periods = (longest_period,) + (1,) * (tiers - 1)
    plan = replace(prepared.plan, scheme=scheme, period_cycles=periods)
    _, told = timed(prepared, (), scheme=scheme, period_cycles=periods)
    assert told.decisions() == in_lockstep(prepared, plan).decisions()


def test_delays_within_the_cycle_change_nothing_but_the_time(prepared: Preparation) -> None:
    # valley has three tiers below the plant: a slice of its second is 0.9 / 11 = 82 ms.
    run, told = timed(prepared, [FaultRule(delay_ms=40.0)])
    assert sum(one.missing_inputs for one in run.sequencers.values()) == 0
    assert told.decisions() == in_lockstep(prepared, prepared.plan).decisions()
    leaf = prepared.plan.tree.leaves[0]
    hops_up_and_down = 3 * prepared.plan.tree.height + 1
    command = told.of(COMMAND.of(leaf))[5]
    assert command.publish_time_ns == 5 * SECOND_NS + hops_up_and_down * 40 * MS


@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32),
    delay_ms=st.floats(0.0, 3000.0),
    jitter_ms=st.floats(0.0, 500.0),
    loss=st.floats(0.0, 0.5),
    duplicate=st.floats(0.0, 0.5),
)
def test_a_run_over_a_bad_network_repeats_to_the_last_bit(
    prepared: Preparation,
    seed: int,
    delay_ms: float,
    jitter_ms: float,
    loss: float,
    duplicate: float,
) -> None:
    rule = FaultRule(delay_ms=delay_ms, jitter_ms=jitter_ms, loss=loss, duplicate=duplicate)
    (one, told), (other, retold) = (
        timed(prepared, [rule], faults_seed=seed, cycles=6) for _ in range(2)
    )
    assert told.bytes() == retold.bytes()
    assert one.faults == other.faults


def test_another_seed_loses_other_messages(prepared: Preparation) -> None:
    _, told = timed(prepared, [FaultRule(loss=0.1)], faults_seed=1)
    _, retold = timed(prepared, [FaultRule(loss=0.1)], faults_seed=2)
    assert told.bytes() != retold.bytes()


def test_a_message_that_is_lost_is_named_as_missing_and_was_sent_all_the_same(
    prepared: Preparation,
) -> None:
    child = prepared.plan.tree.leaves[0]
    rule = FaultRule(source=child, signal="impp", silent=((10.0, 12.0),))
    run, told = timed(prepared, [rule])
    parent = child.rpartition("/")[0]
    said = told.of(IMPP.of(parent))
    assert [cycle for cycle, message in said.items() if message.missing] == [10, 11]
    assert said[10].missing == (f"{child}/impp",)
    assert {10, 11} <= told.of(IMPP.of(child)).keys()
    assert run.faults == {"lost": 2}
    assert run.sequencers[parent].missing_inputs == 2


def test_a_stage_that_lacks_a_message_closes_at_its_deadline(prepared: Preparation) -> None:
    plan = on_the_clock(prepared.plan)
    leaf = plan.tree.leaves[0]
    rule = FaultRule(listener=leaf, signal="telemetry", silent=((7.0, 8.0),))
    _, told = timed(prepared, [rule])
    deadline = plan.deadlines.deadline_ns(leaf, "estimate")
    assert told.of(IMPP.of(leaf))[7].publish_time_ns == 7 * SECOND_NS + deadline
    assert told.of(IMPP.of(leaf))[8].publish_time_ns == 8 * SECOND_NS


def test_the_plant_ticks_on_the_clock_whatever_the_network_does(prepared: Preparation) -> None:
    _, told = timed(prepared, [FaultRule(loss=0.3, delay_ms=400.0, jitter_ms=300.0)])
    leaf = prepared.plan.tree.leaves[0]
    ticks = [message.publish_time_ns for message in told.of(TELEMETRY.of(leaf)).values()]
    assert ticks == [cycle * SECOND_NS for cycle in range(CYCLES)]
    assert len(told.of(PRODUCTION.of(ROOT))) == CYCLES


def test_late_words_are_used_or_dropped_as_the_plan_says(prepared: Preparation) -> None:
    leaf = prepared.plan.tree.leaves[0]
    rule = FaultRule(listener=leaf, signal="setpoint", delay_ms=950.0)
    for late, used in (("use", CYCLES - 1), ("drop", 0)):
        run, told = timed(prepared, [rule], late=late)
        sequencer = run.sequencers[leaf]
        # It never gets a setpoint in time: in the first cycle there is none, later the last one.
        assert sequencer.missing_inputs == CYCLES
        assert sequencer.late_used == used
        instead = f"{leaf}/setpoint@8" if used else f"{leaf}/setpoint"
        assert told.of(COMMAND.of(leaf))[9].missing == (instead,)


def test_a_doubled_message_is_dropped_once(prepared: Preparation) -> None:
    leaf = prepared.plan.tree.leaves[0]
    run, told = timed(prepared, [FaultRule(listener=leaf, signal="setpoint", duplicate=1.0)])
    assert run.faults == {"duplicated": CYCLES}
    drops = run.sequencers[leaf].drops
    assert drops.total() == CYCLES
    assert told.decisions() == in_lockstep(prepared, prepared.plan).decisions()


def test_the_clock_goes_by_the_pace(prepared: Preparation) -> None:
    tenth = replace(prepared.plan, cycle_wall_ns=SECOND_NS // 10)
    assert on_the_clock(tenth) == tenth
    _, told = timed(prepared, [FaultRule(delay_ms=1.0)], cycle_wall_ns=SECOND_NS // 10)
    leaf = prepared.plan.tree.leaves[0]
    assert told.of(TELEMETRY.of(leaf))[7].publish_time_ns == 7 * SECOND_NS // 10


def test_a_run_that_is_stopped_completes_the_cycle_under_way(prepared: Preparation) -> None:
    told = Told()
    run = TimedRun(
        replace(on_the_clock(prepared.plan), faults=(FaultRule(loss=0.2),)), prepared.profile, told
    )
    done = []
    for cycle in run.cycles():
        done.append(cycle)
        if cycle == 4:
            run.stop()
    run.close()
    assert done == [0, 1, 2, 3, 4, 5]
    assert run.sequencers[PLANT].cycle == 6
    assert max(cycle for _, cycle in told.decisions()) == 5
    (_, _), (_, stop) = [(port, m) for port, m in told.messages if port.signal is RUN]
    assert stop.cycle == 6


@pytest.mark.parametrize(
    ("delay_ms", "of_dispatch", "of_an_inverter", "of_a_cluster"),
    [(100.0, 0, 1, 1), (1000.0, 4, 5, 7), (2000.0, 8, 9, 13)],
)
def test_a_step_is_made_good_as_many_hops_later_as_its_way_is_long(
    delay_ms: float, of_dispatch: int, of_an_inverter: int, of_a_cluster: int
) -> None:
    # With deadlines missed, each hop takes whole cycles. The dispatch goes to the central
    # controller, the supervisors, the direct controllers and the plant: 4 hops. What an inverter
    # measured goes to its supervisor and back, 4 hops; what its whole cluster lacks goes by the
    # central controller, 6 hops; both one cycle later, when it is measured.
    oahu = prepare(load_scenario("oahu"), RunOptions(duration="80s"), "steps")
    leaves = oahu.plan.tree.leaves
    sunny, flat = np.full((80, len(leaves)), 400.0), np.full(80, 5000.0)
    cloudy, overcast, more = sunny.copy(), sunny.copy(), flat.copy()
    more[STEP:] = 5500.0
    cloudy[STEP:, 0] = 100.0
    overcast[STEP:, [leaf.startswith("c1/") for leaf in leaves]] = 150.0
    plan = replace(oahu.plan, scheme="paper", faults=(FaultRule(delay_ms=delay_ms),))
    found = [
        settled(plan, Profile(*profile))
        for profile in ((sunny, more), (cloudy, flat), (overcast, flat))
    ]
    assert found == [of_dispatch, of_an_inverter, of_a_cluster]


@pytest.mark.parametrize("scheme", ["paper", "predictive"])
@pytest.mark.parametrize("delay_ms", [0.0, 100.0, 200.0, 1000.0, 5000.0])
def test_before_anything_is_known_nothing_is_held_back(scheme: str, delay_ms: float) -> None:
    oahu = prepare(load_scenario("oahu"), RunOptions(duration="40s"), "beginning")
    sunny, asked = np.full((40, len(oahu.plan.tree.leaves)), 400.0), np.full(40, 5000.0)
    plan = replace(oahu.plan, scheme=scheme, faults=(FaultRule(delay_ms=delay_ms),))
    told = Told()
    for _ in TimedRun(on_the_clock(plan), Profile(sunny, asked), told).cycles():
        pass
    given_kw = [
        message.delivered_kw
        for message in told.of(PRODUCTION.of(ROOT)).values()
        if isinstance(message, Production)
    ]
    assert min(given_kw) >= 5000.0 - 1e-6
    assert given_kw[-1] == pytest.approx(5000.0, abs=1e-6)


def test_residuals_may_be_lost_without_any_harm(prepared: Preparation) -> None:
    _, told = timed(prepared, [FaultRule(signal="residual", loss=1.0)])
    port = PRODUCTION.of(ROOT)
    in_time = in_lockstep(prepared, prepared.plan).of(port)
    found = told.of(port)
    assert [inverters_kw(found[cycle]) for cycle in range(CYCLES)] == [
        inverters_kw(in_time[cycle]) for cycle in range(CYCLES)
    ]


def inverters_kw(production: Message) -> tuple[float, ...]:
    assert isinstance(production, Production)
    return production.inverter_power_kw


STEP = 50


def settled(plan: RunPlan, profile: Profile) -> int:
    """Cycles after the step up to which the plant does not give what is asked of it."""
    told = Told()
    for _ in TimedRun(on_the_clock(plan), profile, told).cycles():
        pass
    made = {
        cycle: message.delivered_kw
        for cycle, message in told.of(PRODUCTION.of(ROOT)).items()
        if isinstance(message, Production)
    }
    assert made[STEP - 1] == pytest.approx(profile.commitment_kw[STEP - 1], abs=1e-6)
    off = [
        cycle
        for cycle in range(STEP, plan.cycles)
        if made[cycle] != pytest.approx(profile.commitment_kw[cycle], abs=1e-6)
    ]
    return off[-1] + 1 - STEP if off else 0
