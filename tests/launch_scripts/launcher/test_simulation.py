"""A whole plant in memory: worked out by hand, and the same in every run."""

from __future__ import annotations

from typing import TypeVar

import msgspec
import numpy as np
import pytest

from agents.plan import RunPlan
from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.signals import (
    COMMAND,
    DISPATCH,
    HELP,
    IMPP,
    METER,
    PRODUCTION,
    RESIDUAL,
    RUN,
    SETPOINT,
    TELEMETRY,
    Port,
)
from bus_schemas.tree import ROOT
from launch_scripts.launcher.simulation import MemoryRun
from launch_scripts.launcher.supervision import RunFailure
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from sim_plant.profile import Profile

M = TypeVar("M", bound=Message)

PLAN = RunPlan(
    run_id="by-hand",
    plant="pair",
    inverters=(("a", 100.0), ("b", 100.0)),
    start_time_ns=0,
    cycle_ns=1_000_000_000,
    cycles=3,
    timezone="UTC",
    regulation_capacity_kw=0.0,
    cycle_wall_ns=0,
    period_cycles=(1,),
    scheme="paper",
    actuator="fraction",
    alpha_min=0.05,
    hold_cycles=3,
    stall_timeout_s=3.0,
    neighbourhoods=(),
    tcp_ports={},
)
"""Two inverters of 100 kW below the central controller, three cycles."""

# A cloud covers a in cycle 1, and both in cycle 2.
PROFILE = Profile(
    mpp_kw=np.array([[80.0, 60.0], [20.0, 64.0], [16.0, 40.0]]),
    commitment_kw=np.array([80.0, 80.0, 120.0]),
)


class Told:
    """All that is said in a run, in its order."""

    def __init__(self) -> None:
        self.messages: list[tuple[Port[Message], Message]] = []

    def __call__(self, port: Port[Message], message: Message) -> None:
        self.messages.append((port, message))

    def get(self, cycle: int, port: Port[M]) -> M | None:
        found = [
            message
            for said_on, message in self.messages
            if said_on is port and message.cycle == cycle
        ]
        assert len(found) <= 1
        for message in found:
            assert isinstance(message, port.signal.type)
            return message
        return None

    def power_kw(self, cycle: int, *said_on: Port[Message]) -> list[float]:
        """What several ports say of power."""
        found = []
        for port in said_on:
            message = self.get(cycle, port)
            assert message is not None, f"no {port} in cycle {cycle}"
            found.append(msgspec.to_builtins(message)["power_kw"])
        return found


def tell(plan: RunPlan, profile: Profile) -> Told:
    told = Told()
    run = MemoryRun(plan, profile, told)
    assert list(run.cycles()) == list(range(plan.cycles))
    run.close()
    return told


@pytest.fixture(scope="module")
def told() -> Told:
    return tell(PLAN, PROFILE)


def production(told: Told, cycle: int) -> tuple[float, float, float, tuple[float, ...]]:
    message = told.get(cycle, PRODUCTION.of(ROOT))
    assert message is not None
    return (
        message.desired_kw,
        message.possible_kw,
        message.delivered_kw,
        message.inverter_power_kw,
    )


def alphas(told: Told, cycle: int) -> list[float]:
    commands = [told.get(cycle, COMMAND.of(leaf)) for leaf in ("a", "b")]
    return [command.alpha for command in commands if command is not None]


def missing_kw(told: Told, cycle: int) -> dict[str, float]:
    calls = {node: told.get(cycle, HELP.of(node)) for node in ("a", "b", ROOT)}
    return {node: call.missing_kw for node, call in calls.items() if call is not None}


def test_cycle_0_both_meet_their_share(told: Told) -> None:
    # Uncurtailed before the run: 80 and 60 kW measured at alpha 1.
    assert told.power_kw(0, TELEMETRY.of("a"), TELEMETRY.of("b")) == [80.0, 60.0]
    assert told.power_kw(0, DISPATCH.of(ROOT)) == [80.0]
    assert told.power_kw(0, METER.of(ROOT)) == [140.0]
    # Equation 1: 80 / 1, 60 / 1. Equation 3: 80 / 2. Equation 4: 80 - 40, 60 - 40.
    assert told.power_kw(0, IMPP.of("a"), IMPP.of("b"), IMPP.of(ROOT)) == [80.0, 60.0, 140.0]
    assert told.power_kw(0, RESIDUAL.of("a"), RESIDUAL.of("b"), RESIDUAL.of(ROOT)) == [40, 20, 60]
    assert missing_kw(told, 0) == {}
    assert told.power_kw(0, SETPOINT.of("a"), SETPOINT.of("b")) == [40.0, 40.0]
    # Equation 6: 40 / 80, 40 / 60.
    assert alphas(told, 0) == [0.5, 40.0 / 60.0]
    # Nothing has changed in the sky: 0.5 x 80 + 2/3 x 60 kW.
    assert production(told, 0) == (80.0, 140.0, 80.0, (40.0, 40.0))


def test_cycle_1_a_cloud_is_felt_before_it_is_measured(told: Told) -> None:
    # Telemetry is of cycle 0, so the setpoints are those of cycle 0.
    assert told.power_kw(1, TELEMETRY.of("a"), TELEMETRY.of("b")) == [40.0, 40.0]
    assert told.power_kw(1, IMPP.of("a"), IMPP.of("b")) == pytest.approx([80.0, 60.0])
    assert missing_kw(told, 1) == {}
    assert told.power_kw(1, SETPOINT.of("a"), SETPOINT.of("b")) == pytest.approx([40.0, 40.0])
    assert alphas(told, 1) == pytest.approx([0.5, 2.0 / 3.0])
    # 0.5 x 20 + 2/3 x 64 kW = 10 + 42.667 kW, of 20 + 64 kW.
    desired_kw, possible_kw, delivered_kw, powers_kw = production(told, 1)
    assert (desired_kw, possible_kw) == (80.0, 84.0)
    assert powers_kw == pytest.approx((10.0, 128.0 / 3.0))
    assert delivered_kw == pytest.approx(10.0 + 128.0 / 3.0)


def test_cycle_2_one_helps_the_other_and_what_both_lack_is_told(told: Told) -> None:
    # Measured in cycle 1: 10 kW at 0.5, 42.667 kW at 2/3.
    assert told.power_kw(2, TELEMETRY.of("a"), TELEMETRY.of("b")) == pytest.approx(
        [10.0, 128.0 / 3.0]
    )
    assert told.power_kw(2, IMPP.of("a"), IMPP.of("b"), IMPP.of(ROOT)) == pytest.approx(
        [20.0, 64.0, 84.0]
    )
    # 120 kW are wanted: 60 of each. a lacks 40, b has 4 to spare: 36 kW are missing.
    assert told.power_kw(2, RESIDUAL.of("a"), RESIDUAL.of("b"), RESIDUAL.of(ROOT)) == pytest.approx(
        [-40.0, 4.0, -36.0]
    )
    assert missing_kw(told, 2) == pytest.approx({"a": 40.0, ROOT: 36.0})
    # Each gives all it has, b 4 kW above its share for a.
    assert told.power_kw(2, SETPOINT.of("a"), SETPOINT.of("b")) == pytest.approx([20.0, 64.0])
    of_a, of_b = told.get(2, SETPOINT.of("a")), told.get(2, SETPOINT.of("b"))
    assert of_a is not None
    assert of_b is not None
    assert (of_a.share_kw, of_a.help_given) == (60.0, ())
    (line,) = of_b.help_given
    assert (of_b.share_kw, line.needy) == (60.0, "a")
    assert line.power_kw == pytest.approx(4.0)
    assert alphas(told, 2) == [1.0, 1.0]
    assert production(told, 2) == (120.0, 56.0, 56.0, (16.0, 40.0))


def test_a_run_begins_and_ends_with_a_message_of_the_plant(told: Told) -> None:
    words = [message for port, message in told.messages if port is RUN.of(ROOT)]
    assert [(word.cycle, msgspec.to_builtins(word)["state"]) for word in words] == [
        (0, "start"),
        (3, "stop"),
    ]
    assert told.messages[0][1] is words[0]
    assert told.messages[-1][1] is words[1]


def test_a_run_that_is_stopped_ends_after_the_cycle_under_way() -> None:
    told = Told()
    run = MemoryRun(PLAN, PROFILE, told)
    cycles = run.cycles()
    assert next(cycles) == 0
    run.stop()
    assert list(cycles) == [1]
    assert told.get(1, PRODUCTION.of(ROOT)) is not None
    assert told.get(2, DISPATCH.of(ROOT)) is None


def test_a_run_that_cannot_go_on_says_who_waits_for_what() -> None:
    # Of a wish that is no number nobody can work out a share, so that nobody sends anything.
    profile = Profile(PROFILE.mpp_kw, np.array([np.nan, 80.0, 80.0]))
    with pytest.raises(RunFailure, match=r"cycle 0: plant waits for a/command, b/command"):
        list(MemoryRun(PLAN, profile).cycles())


# The same in every run ----------------------------------------------------------------------------

CYCLES = 40


def preparation(seed: int) -> Preparation:
    options = RunOptions(duration=f"{CYCLES}s", seed=seed)
    return prepare(load_scenario("oahu"), options, "by-hand")


def wire(prepared: Preparation) -> list[tuple[str, bytes]]:
    """Key and payload of all that is said, without the times of publishing."""
    told = tell(prepared.plan, prepared.profile)
    keys = prepared.plan.keys
    return [
        (
            keys.key(port),
            encode(msgspec.structs.replace(message, publish_time_ns=0, ready_time_ns=0)),
        )
        for port, message in told.messages
        if port.signal is not RUN
    ]


def test_one_seed_gives_the_same_messages_to_the_last_bit() -> None:
    first, second = wire(preparation(seed=5)), wire(preparation(seed=5))
    assert first == second
    without_help = [key for key, _ in first if not key.endswith(("/help", "/notice"))]
    # Dispatch, meter, production; telemetry and command of 17; setpoint of 20; impp and residual
    # of 21.
    assert len(without_help) == CYCLES * (3 + 2 * 17 + 20 + 2 * 21) == CYCLES * 99


def test_another_seed_is_another_day() -> None:
    first, second = preparation(seed=5), preparation(seed=6)
    assert not np.array_equal(first.profile.mpp_kw, second.profile.mpp_kw)
    assert wire(first) != wire(second)


def test_every_cycle_of_a_prepared_run_is_complete() -> None:
    prepared = preparation(seed=5)
    run = MemoryRun(prepared.plan, prepared.profile)
    assert list(run.cycles()) == list(range(CYCLES))
    assert all(not loop.dropped for loop in run.loops.values())
    published = run.bus.outbox.published
    assert (published["production"], published["command"]) == (CYCLES, CYCLES * 17)
    assert published["notice"] == 0


def test_a_message_goes_through_six_hops_in_a_cycle() -> None:
    """The longest way through a cycle's messages, from sender to whoever awaits them in a stage."""
    prepared = preparation(seed=5)
    told = tell(prepared.plan, prepared.profile)
    tree = prepared.plan.tree
    wiring = prepared.plan.wiring
    hops: dict[str, int] = {}
    for port, message in told.messages:
        if message.cycle == 3 and port.signal.decided and wiring.listeners[port]:
            # It comes after all that its sender had heard by then in this cycle.
            before = [hops.get(str(heard), 0) for heard in wiring.heard.get(message.source, ())]
            hops[str(port)] = 1 + max(before)
    assert max(hops.values()) == 2 + 2 * tree.height == 6
