"""The plant as an agent: what it measures, what its inverters apply, what it produces."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.sequencer import Sequencer
from bus_schemas.messages import Command, Dispatch, Message, Production, Telemetry
from bus_schemas.signals import COMMAND, DISPATCH, PRODUCTION, TELEMETRY, Port
from bus_schemas.tree import ROOT, ControlTree
from sim_plant.inverter import delivered_power_kw
from sim_plant.plant import Plant, PlantState
from sim_plant.profile import Profile

TREE = ControlTree((("c1/a", 100.0), ("c1/b", 100.0)))
PROFILE = Profile(
    mpp_kw=np.array([[80.0, 60.0], [100.0, 40.0], [50.0, 0.0]]),
    commitment_kw=np.array([100.0, 90.0, 70.0]),
)
CYCLE_NS = 1_000_000_000

Said = dict[Port[Message], Message]


def plant(*, lockstep: bool = True) -> Sequencer[PlantState]:
    sequencer = Sequencer(
        Plant(TREE, PROFILE), lambda cycle: cycle * CYCLE_NS, lockstep=lockstep, horizon=1
    )
    sequencer.end_before(PROFILE.cycles)
    return sequencer


def command(sequencer: Sequencer[PlantState], node: str, alpha: float) -> Said:
    cycle = sequencer.cycle
    message = Command(cycle, cycle * CYCLE_NS, node, (), alpha=alpha, power_kw=0.0)
    return dict(sequencer.accept(COMMAND.of(node), message))


def told(said: Said, cycle: int) -> list[tuple[float, float]]:
    """Power and alpha in the telemetry of each inverter."""
    found = []
    for leaf in TREE.leaves:
        message = said[TELEMETRY.of(leaf)]
        assert isinstance(message, Telemetry)
        assert (message.cycle, message.sim_time_ns) == (cycle, cycle * CYCLE_NS)
        found.append((message.power_kw, message.alpha))
    return found


def production(said: Said) -> Production:
    message = said[PRODUCTION.of(ROOT)]
    assert isinstance(message, Production)
    return message


def test_before_cycle_0_the_inverters_stand_uncurtailed_under_the_first_sample() -> None:
    assert told(dict(plant().enter(0)), 0) == [(80.0, 1.0), (60.0, 1.0)]


def test_a_cycle_begins_with_the_operators_wish_for_it() -> None:
    assert plant().enter(0)[0] == (
        DISPATCH.of(ROOT),
        Dispatch(0, 0, "plant", (), power_kw=100.0, commitment_kw=100.0, regulation_kw=0.0),
    )


def test_telemetry_is_of_the_interval_that_just_ended() -> None:
    sequencer = plant()
    sequencer.enter(0)
    command(sequencer, "c1/a", 0.5)
    said = command(sequencer, "c1/b", 1.0)
    # In cycle 0: 0.5 x 80 and 1.0 x 60 kW.
    assert told(said, 1) == [(40.0, 0.5), (60.0, 1.0)]
    command(sequencer, "c1/a", 0.9)
    said = command(sequencer, "c1/b", 0.25)
    # In cycle 1: 0.9 x 100 and 0.25 x 40 kW.
    assert told(said, 2) == [(90.0, 0.9), (10.0, 0.25)]


def test_production_adds_up() -> None:
    sequencer = plant()
    sequencer.enter(0)
    command(sequencer, "c1/a", 0.5)
    assert production(command(sequencer, "c1/b", 1.0)) == Production(
        0,
        0,
        "plant",
        (),
        desired_kw=100.0,
        possible_kw=140.0,
        delivered_kw=100.0,
        inverter_mpp_kw=(80.0, 60.0),
        inverter_power_kw=(40.0, 60.0),
    )


def test_the_last_cycle_is_followed_by_no_other() -> None:
    sequencer = plant()
    sequencer.enter(0)
    said: Said = {}
    for _ in range(PROFILE.cycles):
        command(sequencer, "c1/a", 1.0)
        said = command(sequencer, "c1/b", 1.0)
    assert list(said) == [PRODUCTION.of(ROOT)]
    assert production(said).delivered_kw == 50.0
    assert sequencer.finished


def test_without_a_command_an_inverter_keeps_its_last_alpha() -> None:
    sequencer = plant(lockstep=False)
    sequencer.enter(0)
    sequencer.close_stage()  # the tick
    command(sequencer, "c1/a", 0.5)
    command(sequencer, "c1/b", 0.5)
    sequencer.close_stage()
    command(sequencer, "c1/a", 0.25)
    said = dict(sequencer.close_stage())
    # 0.25 x 100 and, with the alpha of the cycle before, 0.5 x 40 kW.
    assert production(said).inverter_power_kw == (25.0, 20.0)
    assert production(said).missing == ("c1/b/command",)
    assert told(dict(sequencer.close_stage()), 2) == [(25.0, 0.25), (20.0, 0.5)]


@pytest.mark.parametrize("alpha", [math.nan, math.inf, -math.inf, -0.5, 0.0, 1.001])
def test_an_absurd_alpha_is_not_applied(alpha: float) -> None:
    sequencer = plant()
    sequencer.enter(0)
    command(sequencer, "c1/a", 0.5)
    command(sequencer, "c1/b", 0.5)
    command(sequencer, "c1/a", alpha)
    said = command(sequencer, "c1/b", 1.0)
    assert production(said).inverter_power_kw == (50.0, 40.0)
    assert told(said, 2) == [(50.0, 0.5), (40.0, 1.0)]


def test_in_real_time_the_plant_waits_for_the_tick() -> None:
    sequencer = plant(lockstep=False)
    assert sequencer.enter(0) == []
    assert told(dict(sequencer.close_stage()), 0) == [(80.0, 1.0), (60.0, 1.0)]


def test_an_arming_round_stands_under_the_first_sample_and_moves_nothing() -> None:
    sequencer = plant()
    assert told(dict(sequencer.enter(-5)), -5) == [(80.0, 1.0), (60.0, 1.0)]
    command(sequencer, "c1/a", 0.5)
    assert production(command(sequencer, "c1/b", 0.5)).inverter_power_kw == (40.0, 30.0)
    assert told(dict(sequencer.enter(0)), 0) == [(80.0, 1.0), (60.0, 1.0)]


def test_an_inverter_delivers_its_fraction_of_what_is_there() -> None:
    found = delivered_power_kw(
        np.array([80.0, 60.0, 0.0]), np.array([0.5, 1.0, 0.3]), np.full(3, 100.0)
    )
    assert found.tolist() == [40.0, 60.0, 0.0]


def test_an_inverter_with_a_limit_holds_it_and_gives_all_it_has_below_it() -> None:
    found = delivered_power_kw(np.array([80.0, 60.0, 20.0]), np.ones(3), np.full(3, 60.0))
    assert found.tolist() == [60.0, 60.0, 20.0]


def test_inverters_of_the_limit_kind_obey_the_power_and_not_the_alpha() -> None:
    limited = Sequencer(
        Plant(TREE, PROFILE, "limit"), lambda cycle: cycle * CYCLE_NS, lockstep=True, horizon=1
    )
    limited.enter(0)
    for node, power_kw in (("c1/a", 30.0), ("c1/b", 90.0)):
        message = Command(0, 0, node, (), alpha=0.5, power_kw=power_kw)
        said = dict(limited.accept(COMMAND.of(node), message))
    assert production(said).inverter_power_kw == (30.0, 60.0)
    limits_kw = [m.limit_kw for m in said.values() if isinstance(m, Telemetry)]
    assert limits_kw == [30.0, 90.0]


def test_a_meter_reads_what_was_delivered_with_its_error() -> None:
    error = np.array([[0.0, 0.0], [0.01, -0.01]])
    profile = Profile(np.full((2, 2), 80.0), np.full(2, 100.0), meter_error=error)
    sequencer = Sequencer(
        Plant(TREE, profile), lambda cycle: cycle * CYCLE_NS, lockstep=True, horizon=1
    )
    sequencer.end_before(2)
    assert told(dict(sequencer.enter(0)), 0) == [(80.0, 1.0), (80.0, 1.0)]
    command(sequencer, "c1/a", 0.5)
    said = command(sequencer, "c1/b", 1.0)
    assert production(said).inverter_power_kw == (40.0, 80.0)
    assert told(said, 1) == [(40.0 * 1.01, 0.5), (80.0 * 0.99, 1.0)]


def test_the_dispatch_is_commitment_and_regulation() -> None:
    profile = Profile(np.full((1, 2), 80.0), np.array([100.0]), np.array([-20.0]), 50.0)
    said = dict(Sequencer(Plant(TREE, profile), lambda c: 0, lockstep=True, horizon=1).enter(0))
    dispatch = said[DISPATCH.of("")]
    assert isinstance(dispatch, Dispatch)
    found = (dispatch.power_kw, dispatch.commitment_kw, dispatch.regulation_kw)
    assert found == (80.0, 100.0, -20.0)
