"""A whole plant in memory: worked out by hand, and the same in every run."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from plans_by_hand import plan_of
from sent_messages import Sent

from agents.events import Waiting
from agents.plan import RunPlan
from bus_schemas.codec import encode
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
from launch_scripts.launcher.supervision import RunFailure, who_waits
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from sim_plant.profile import Profile

PLAN = plan_of({"a": 100.0, "b": 100.0}, cycles=3)
"""Two inverters of 100 kW below the central controller, three cycles."""

# A cloud covers a in cycle 1, and both in cycle 2.
PROFILE = Profile(
    mpp_kw=np.array([[80.0, 60.0], [20.0, 64.0], [16.0, 40.0]]),
    commitment_kw=np.array([80.0, 80.0, 120.0]),
)


def power_kw(sent: Sent, cycle: int, *ports: Port[Any]) -> list[float]:
    """What several ports say of power in a cycle."""
    return [sent.of(port)[cycle].power_kw for port in ports]


def sent_in(plan: RunPlan, profile: Profile) -> Sent:
    sent = Sent()
    run = MemoryRun(plan, profile, sent)
    assert list(run.cycles()) == list(range(plan.cycles))
    run.close()
    return sent


@pytest.fixture(scope="module")
def sent() -> Sent:
    return sent_in(PLAN, PROFILE)


def production(sent: Sent, cycle: int) -> tuple[float, float, float, tuple[float, ...]]:
    message = sent.of(PRODUCTION.of(ROOT)).get(cycle)
    assert message is not None
    return (
        message.desired_kw,
        message.possible_kw,
        message.delivered_kw,
        message.inverter_power_kw,
    )


def alphas(sent: Sent, cycle: int) -> list[float]:
    commands = [sent.of(COMMAND.of(leaf)).get(cycle) for leaf in ("a", "b")]
    return [command.alpha for command in commands if command is not None]


def missing_kw(sent: Sent, cycle: int) -> dict[str, float]:
    calls = {node: sent.of(HELP.of(node)).get(cycle) for node in ("a", "b", ROOT)}
    return {node: call.missing_kw for node, call in calls.items() if call is not None}


def test_cycle_0_both_meet_their_share(sent: Sent) -> None:
    # Uncurtailed before the run: 80 and 60 kW measured at alpha 1.
    assert power_kw(sent, 0, TELEMETRY.of("a"), TELEMETRY.of("b")) == [80.0, 60.0]
    assert power_kw(sent, 0, DISPATCH.of(ROOT)) == [80.0]
    assert power_kw(sent, 0, METER.of(ROOT)) == [140.0]
    # Equation 1: 80 / 1, 60 / 1. Equation 3: 80 / 2. Equation 4: 80 - 40, 60 - 40.
    assert power_kw(sent, 0, IMPP.of("a"), IMPP.of("b"), IMPP.of(ROOT)) == [80.0, 60.0, 140.0]
    assert power_kw(sent, 0, RESIDUAL.of("a"), RESIDUAL.of("b"), RESIDUAL.of(ROOT)) == [40, 20, 60]
    assert missing_kw(sent, 0) == {}
    assert power_kw(sent, 0, SETPOINT.of("a"), SETPOINT.of("b")) == [40.0, 40.0]
    # Equation 6: 40 / 80, 40 / 60.
    assert alphas(sent, 0) == [0.5, 40.0 / 60.0]
    # Nothing has changed in the sky: 0.5 x 80 + 2/3 x 60 kW.
    assert production(sent, 0) == (80.0, 140.0, 80.0, (40.0, 40.0))


def test_cycle_1_a_cloud_is_felt_before_it_is_measured(sent: Sent) -> None:
    # Telemetry is of cycle 0, so the setpoints are those of cycle 0.
    assert power_kw(sent, 1, TELEMETRY.of("a"), TELEMETRY.of("b")) == [40.0, 40.0]
    assert power_kw(sent, 1, IMPP.of("a"), IMPP.of("b")) == pytest.approx([80.0, 60.0])
    assert missing_kw(sent, 1) == {}
    assert power_kw(sent, 1, SETPOINT.of("a"), SETPOINT.of("b")) == pytest.approx([40.0, 40.0])
    assert alphas(sent, 1) == pytest.approx([0.5, 2.0 / 3.0])
    # 0.5 x 20 + 2/3 x 64 kW = 10 + 42.667 kW, of 20 + 64 kW.
    desired_kw, possible_kw, delivered_kw, powers_kw = production(sent, 1)
    assert (desired_kw, possible_kw) == (80.0, 84.0)
    assert powers_kw == pytest.approx((10.0, 128.0 / 3.0))
    assert delivered_kw == pytest.approx(10.0 + 128.0 / 3.0)


def test_cycle_2_one_helps_the_other_and_what_both_lack_is_told(sent: Sent) -> None:
    # Measured in cycle 1: 10 kW at 0.5, 42.667 kW at 2/3.
    assert power_kw(sent, 2, TELEMETRY.of("a"), TELEMETRY.of("b")) == pytest.approx(
        [10.0, 128.0 / 3.0]
    )
    assert power_kw(sent, 2, IMPP.of("a"), IMPP.of("b"), IMPP.of(ROOT)) == pytest.approx(
        [20.0, 64.0, 84.0]
    )
    # 120 kW are wanted: 60 of each. a lacks 40, b has 4 to spare: 36 kW are missing.
    assert power_kw(
        sent, 2, RESIDUAL.of("a"), RESIDUAL.of("b"), RESIDUAL.of(ROOT)
    ) == pytest.approx([-40.0, 4.0, -36.0])
    assert missing_kw(sent, 2) == pytest.approx({"a": 40.0, ROOT: 36.0})
    # Each gives all it has, b 4 kW above its share for a.
    assert power_kw(sent, 2, SETPOINT.of("a"), SETPOINT.of("b")) == pytest.approx([20.0, 64.0])
    of_a, of_b = sent.of(SETPOINT.of("a")).get(2), sent.of(SETPOINT.of("b")).get(2)
    assert of_a is not None
    assert of_b is not None
    assert (of_a.share_kw, of_a.help_given) == (60.0, ())
    (line,) = of_b.help_given
    assert (of_b.share_kw, line.needy) == (60.0, "a")
    assert line.power_kw == pytest.approx(4.0)
    assert alphas(sent, 2) == [1.0, 1.0]
    assert production(sent, 2) == (120.0, 56.0, 56.0, (16.0, 40.0))


def test_a_run_begins_and_ends_with_a_message_of_the_plant(sent: Sent) -> None:
    words = [message for port, message in sent.messages if port is RUN.of(ROOT)]
    assert [(word.cycle, msgspec.to_builtins(word)["state"]) for word in words] == [
        (0, "start"),
        (3, "stop"),
    ]
    assert sent.messages[0][1] is words[0]
    assert sent.messages[-1][1] is words[1]


def test_a_run_that_is_stopped_ends_after_the_cycle_under_way() -> None:
    sent = Sent()
    run = MemoryRun(PLAN, PROFILE, sent)
    cycles = run.cycles()
    assert next(cycles) == 0
    run.stop()
    assert list(cycles) == [1]
    assert sent.of(PRODUCTION.of(ROOT)).get(1) is not None
    assert sent.of(DISPATCH.of(ROOT)).get(2) is None


def test_a_run_that_cannot_go_on_says_who_waits_for_what() -> None:
    # Without a dispatch that it can use the central controller sends no setpoints.
    profile = Profile(PROFILE.mpp_kw, np.array([np.nan, 80.0, 80.0]))
    with pytest.raises(
        RunFailure, match=r"cycle 0: .*dispatch.* central; a waits for a/setpoint, b"
    ):
        list(MemoryRun(PLAN, profile).cycles())


def test_an_agent_that_says_nothing_more_is_to_blame_and_not_those_who_are_ahead() -> None:
    waiting = {
        "plant": Waiting(7, "apply", [("a/command", "a"), ("b/command", "b")]),
        "central": Waiting(8, "solve", [("dispatch", "plant")]),
        "a": Waiting(8, "estimate", [("a/telemetry", "plant")]),
    }
    line, to_blame = who_waits(waiting)
    assert to_blame == ["b"]
    assert line.startswith("stalled in cycle 7: ")
    assert line.endswith("plant waits for b/command")


# The same in every run ----------------------------------------------------------------------------

CYCLES = 40


def preparation(seed: int) -> Preparation:
    options = RunOptions(duration=f"{CYCLES}s", seed=seed)
    return prepare(load_scenario("oahu"), options, "by-hand")


def wire(prepared: Preparation) -> list[tuple[str, bytes]]:
    """Key and payload of all that is said, without the times of publishing."""
    sent = sent_in(prepared.plan, prepared.profile)
    keys = prepared.plan.keys
    return [
        (
            keys.key(port),
            encode(msgspec.structs.replace(message, publish_time_ns=0, ready_time_ns=0)),
        )
        for port, message in sent.messages
        if port.signal is not RUN
    ]


def test_one_seed_gives_the_same_messages_to_the_last_bit() -> None:
    first, second = wire(preparation(seed=5)), wire(preparation(seed=5))
    assert first == second
    assert first != wire(preparation(seed=6))
    without_help = [key for key, _ in first if not key.endswith(("/help", "/notice"))]
    # Dispatch, meter, production; telemetry and command of 17; setpoint of 20; impp and residual
    # of 21.
    assert len(without_help) == CYCLES * (3 + 2 * 17 + 20 + 2 * 21) == CYCLES * 99


def test_a_message_goes_through_six_hops_in_a_cycle() -> None:
    """The longest way through a cycle's messages, from sender to whoever awaits them in a stage."""
    prepared = preparation(seed=5)
    sent = sent_in(prepared.plan, prepared.profile)
    tree = prepared.plan.tree
    wiring = prepared.plan.wiring
    hops: dict[str, int] = {}
    for port, message in sent.messages:
        if message.cycle == 3 and port.signal.decided and wiring.listeners[port]:
            # It comes after all that its sender had heard by then in this cycle.
            before = [hops.get(str(heard), 0) for heard in wiring.heard.get(message.source, ())]
            hops[str(port)] = 1 + max(before)
    assert max(hops.values()) == 2 + 2 * tree.height == 6
