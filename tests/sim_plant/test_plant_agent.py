"""The plant as an agent: what it measures, what its inverters apply, what it produces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from complaints import complaint_of
from plans_by_hand import CYCLE_NS, plan_of, with_changes
from plants_by_hand import AtWork, at, command, memory

from agents.plan_parts import Site
from agents.settings import Revert
from bus_schemas.messages import Message
from bus_schemas.signals import DISPATCH, METER, PRODUCTION, TELEMETRY, Port
from bus_schemas.tree import ROOT
from sim_plant.inverters import stated_kw
from sim_plant.plant import Plant
from sim_plant.profile import Profile, load_profile

PROFILE = Profile(
    mpp_kw=np.array([[80.0, 60.0], [100.0, 40.0], [50.0, 0.0]]),
    commitment_kw=np.array([100.0, 90.0, 70.0]),
)
LEAVES = ("c1/a", "c1/b")
PLAN = plan_of(dict.fromkeys(LEAVES, 100.0), cycles=3)

Sent = dict[Port[Message], Any]


class PlantAtWork(AtWork):
    """The plant in its loop."""

    def __init__(self, profile: Profile = PROFILE, **changes: object) -> None:
        plan = with_changes(PLAN, cycles=profile.cycles, **changes)
        super().__init__(plan, Plant(plan, profile))

    def begin(self) -> Sent:
        self.loop.begin(0, 0)
        return self.hear()

    def command(self, *alphas: float) -> Sent:
        """Command inverters, in their order; return what the plant sends then."""
        commanded, cycle = zip(LEAVES, alphas, strict=False), self.loop.cycle
        return self.hear(memory(cycle), *(command(leaf, cycle, alpha) for leaf, alpha in commanded))


def measured(sent: Sent, cycle: int) -> list[tuple[float, float]]:
    """Power and alpha in the telemetry of each inverter."""
    found = [sent[TELEMETRY.of(leaf)] for leaf in LEAVES]
    assert {(m.cycle, m.sim_time_ns) for m in found} == {(cycle, cycle * CYCLE_NS)}
    return [(m.power_kw, m.alpha) for m in found]


def powers_kw(sent: Sent) -> tuple[float, ...]:
    return at(sent, PRODUCTION.of(ROOT)).inverter_power_kw


@pytest.mark.parametrize(("share", "count"), [(0.28, 7), (0.281, 8), (0.0, 0), (1.0, 25)])
def test_as_many_inverters_state_their_available_power_as_the_share_says(
    share: float, count: int
) -> None:
    site = Site(available_bias=0.0, available_share=share)
    found = stated_kw(np.ones(25), np.ones(25), site)
    assert np.isfinite(found).sum() == count


def test_a_cycle_begins_with_the_operators_wish_and_the_rating_that_it_is_shared_by() -> None:
    profile = Profile(np.full((1, 2), 80.0), np.array([100.0]), np.array([-20.0]), 50.0)
    found = PlantAtWork(profile).begin()[DISPATCH.of(ROOT)]
    assert (found.power_kw, found.commitment_kw, found.regulation_kw) == (80.0, 100.0, -20.0)
    assert found.plant_rating_kw == 200.0


def test_without_a_command_an_inverter_keeps_its_last_alpha() -> None:
    plant = PlantAtWork(cycle_wall_ns=CYCLE_NS)
    assert plant.begin() == {}, "in real time the plant waits for the tick"
    assert measured(plant.at_deadline(), 0) == [(80.0, 1.0), (60.0, 1.0)]
    plant.command(0.5, 0.5)
    plant.at_deadline()
    plant.command(0.25)
    sent = plant.at_deadline()
    # 0.25 x 100 and, with the alpha of the cycle before, 0.5 x 40 kW.
    assert powers_kw(sent) == (25.0, 20.0)
    assert sent[PRODUCTION.of(ROOT)].missing == ("c1/b/command@0",)
    assert measured(plant.at_deadline(), 2) == [(25.0, 0.25), (20.0, 0.5)]


def test_an_arming_round_stands_under_the_first_sample_and_moves_nothing() -> None:
    plant = PlantAtWork()
    plant.loop.enter(-5, 0)
    assert measured(plant.command(), -5) == [(80.0, 1.0), (60.0, 1.0)]
    assert powers_kw(plant.command(0.5, 0.5)) == (40.0, 30.0)
    assert measured(plant.begin(), 0) == [(80.0, 1.0), (60.0, 1.0)]


def test_an_inverters_meter_reads_what_was_delivered_with_its_error_and_the_plants_is_exact() -> (
    None
):
    error = np.array([[0.0, 0.0], [0.01, -0.01]])
    profile = Profile(np.full((2, 2), 80.0), np.full(2, 100.0), meter_error=error)
    plant = PlantAtWork(profile)
    plant.begin()
    sent = plant.command(0.5, 1.0)
    assert measured(sent, 1) == [(40.0 * 1.01, 0.5), (80.0 * 0.99, 1.0)]
    assert sent[METER.of(ROOT)].power_kw == 120.0


@pytest.mark.parametrize(
    ("bias", "stated_kw"), [(None, (None, None)), (0.0, (80.0, 60.0)), (0.5, (100.0, 90.0))]
)
def test_inverters_state_their_available_power_with_a_bias_up_to_the_rating_or_not_at_all(
    bias: float | None, stated_kw: tuple[float | None, ...]
) -> None:
    plant = PlantAtWork(available_bias=bias)
    plant.begin()
    # What was available in cycle 0, curtailed or not.
    sent = plant.command(0.5, 0.5)
    assert tuple(sent[TELEMETRY.of(leaf)].available_kw for leaf in LEAVES) == stated_kw


# How inverters follow ----------------------------------------------------------------------------

FLAT = Profile(np.full((12, 2), 100.0), np.full(12, 100.0))
"""Each could give 100 kW, and its share is 50 kW."""

ON = dict(enumerate([1.0] + [0.5] * 7))
"""Commands in every cycle: all at first, then half."""

IN_2_S, IN_3_S = Revert(after_s=2.0, to=0.2), Revert(after_s=3.0, to=0.2)
SHORT = {"cycle_ns": 700_000_000}


@pytest.mark.parametrize("actuator", ["fraction", "limit"])
@pytest.mark.parametrize(
    ("commands", "changes", "expected_kw"),
    [
        (ON, {}, [100, 50, 50, 50]),
        # It begins at its share. A ramp is one of time, whatever the cycle.
        (ON, {"ramp_percent_per_s": 20.0}, [70, 50, 50, 50]),
        ({0: 0.9}, {"ramp_percent_per_s": 20.0, "cycle_ns": 200_000_000}, [54, 58, 62, 66, 70, 74]),
        ({0: 0.1}, {"ramp_percent_per_s": 2.0, "cycle_ns": 10_000_000_000}, [30, 10, 10]),
        # Until its first command acts, an inverter holds its share. A part of a cycle is a cycle,
        (ON, {"delay_s": 1.5}, [50, 50, 100, 50]),
        ({}, {}, [50, 50]),
        # but 4.2 s are 6 cycles of 0.7 s, though 4.2 / 0.7 is a little more than 6.
        ({0: 0.2}, {"delay_s": 4.2, **SHORT}, [50] * 6 + [20] * 2),
        ({0: 0.2}, {"revert": Revert(after_s=4.2, to=0.3), **SHORT}, [20] * 6 + [30] * 2),
        # It reverts to what is set, or to what it was commanded; a fresh command undoes that.
        ({0: 0.7}, {"revert": Revert(after_s=2.0)}, [70, 70, 35, 35]),
        ({0: 0.7, 4: 0.7}, {"revert": IN_2_S}, [70, 70, 20, 20, 70, 70, 20]),
        # A revert forgets commands that had not yet taken effect.
        ({0: 0.5, 6: 0.5}, {"revert": IN_3_S, "delay_s": 2.0}, [50, 50, 50, 20, 20, 20, 20, 20]),
    ],
)
def test_an_inverter_obeys_its_commands(
    commands: dict[int, float], changes: dict[str, Any], expected_kw: list[float], actuator: str
) -> None:
    plant = PlantAtWork(FLAT, actuator=actuator, cycle_wall_ns=CYCLE_NS, **changes)
    plant.begin()
    found = []
    for cycle in range(len(expected_kw)):
        plant.at_deadline()
        level = commands.get(cycle)
        sent = plant.at_deadline() if level is None else plant.command(level, level)
        found.append(powers_kw(sent)[0])
    assert found == pytest.approx(expected_kw)


# Profiles ----------------------------------------------------------------------------------------


def test_wrong_profiles_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "profile.npz"
    assert complaint_of(load_profile, path, 2, 1).startswith(f"{path}: ")
    path.write_bytes(b"nope")
    assert complaint_of(load_profile, path, 2, 1).startswith(f"{path}: ")
    np.savez_compressed(path, mpp_kw=np.zeros((2, 1)))
    assert complaint_of(load_profile, path, 2, 1).startswith(f"{path}: ")
