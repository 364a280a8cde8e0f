"""The plant as an agent: what it measures, what its inverters apply, what it produces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from complaints import complaint_of
from plans_by_hand import CYCLE_NS, plan_of, with_changes

from agents.loop import Loop
from agents.settings import InverterSettings, Revert
from bus_schemas.messages import Command, Message, Production
from bus_schemas.signals import COMMAND, DISPATCH, METER, PRODUCTION, TELEMETRY, Port
from bus_schemas.tree import ROOT
from sim_plant.plant import Plant
from sim_plant.profile import Profile, load_profile

PROFILE = Profile(
    mpp_kw=np.array([[80.0, 60.0], [100.0, 40.0], [50.0, 0.0]]),
    commitment_kw=np.array([100.0, 90.0, 70.0]),
)
LEAVES = ("c1/a", "c1/b")
PLAN = plan_of(dict.fromkeys(LEAVES, 100.0), cycles=3)

Sent = dict[Port[Message], Any]


class PlantAtWork:
    """The plant in its loop."""

    def __init__(self, profile: Profile = PROFILE, **changes: object) -> None:
        plan = with_changes(PLAN, cycles=profile.cycles, **changes)
        self.loop = Loop(Plant(plan, profile), plan)

    def begin(self) -> Sent:
        self.loop.begin(0, 0)
        return self.sent()

    def command(self, *alphas: float, power_kw: tuple[float, ...] = (0.0, 0.0)) -> Sent:
        """Command inverters, in their order; return what the plant sends then."""
        cycle = self.loop.cycle
        for leaf, alpha, kw in zip(LEAVES, alphas, power_kw, strict=False):
            message = Command(cycle, cycle * CYCLE_NS, leaf, (), alpha=alpha, power_kw=kw)
            self.loop.hear(COMMAND.of(leaf), message, 0)
        return self.sent()

    def at_deadline(self) -> Sent:
        return dict(self.loop.close_stage(0)) | self.sent()

    def sent(self) -> Sent:
        found: Sent = {}
        while self.loop.is_complete:
            found.update(self.loop.close_stage(0))
        return found


def measured(sent: Sent, cycle: int) -> list[tuple[float, float]]:
    """Power and alpha in the telemetry of each inverter."""
    found = [sent[TELEMETRY.of(leaf)] for leaf in LEAVES]
    assert {(m.cycle, m.sim_time_ns) for m in found} == {(cycle, cycle * CYCLE_NS)}
    return [(m.power_kw, m.alpha) for m in found]


def powers_kw(sent: Sent) -> tuple[float, ...]:
    made = sent[PRODUCTION.of(ROOT)]
    assert isinstance(made, Production)
    return made.inverter_power_kw


def test_a_cycle_begins_with_the_operators_wish_and_the_rating_that_it_is_shared_by() -> None:
    profile = Profile(np.full((1, 2), 80.0), np.array([100.0]), np.array([-20.0]), 50.0)
    found = PlantAtWork(profile).begin()[DISPATCH.of(ROOT)]
    assert (found.power_kw, found.commitment_kw, found.regulation_kw) == (80.0, 100.0, -20.0)
    assert found.plant_rating_kw == 200.0


def test_telemetry_and_meter_are_of_the_interval_that_just_ended() -> None:
    plant = PlantAtWork()
    plant.begin()
    sent = plant.command(0.5, 1.0)
    # In cycle 0: 0.5 x 80 and 1.0 x 60 kW.
    assert measured(sent, 1) == [(40.0, 0.5), (60.0, 1.0)]
    assert sent[METER.of(ROOT)].power_kw == 100.0
    sent = plant.command(0.9, 0.25)
    # In cycle 1: 0.9 x 100 and 0.25 x 40 kW.
    assert measured(sent, 2) == [(90.0, 0.9), (10.0, 0.25)]
    assert sent[METER.of(ROOT)].power_kw == 100.0


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


def test_inverters_of_the_limit_kind_obey_the_power_and_not_the_alpha() -> None:
    plant = PlantAtWork(actuator="limit")
    plant.begin()
    sent = plant.command(0.5, 0.5, power_kw=(30.0, 90.0))
    assert powers_kw(sent) == (30.0, 60.0)
    assert [sent[TELEMETRY.of(leaf)].limit_kw for leaf in LEAVES] == [30.0, 90.0]


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


def followed(cycles: int = 4, **changes: object) -> list[tuple[float, float]]:
    """Return what both deliver that are told to give half from cycle 1 on."""
    plant = PlantAtWork(FLAT, **changes)
    plant.begin()
    found = [powers_kw(plant.command(*[1.0 if n == 0 else 0.5] * 2)) for n in range(cycles)]
    return [(round(one, 6), round(other, 6)) for one, other in found]


def test_a_command_takes_effect_after_its_delay_and_as_fast_as_the_ramp_allows() -> None:
    at_once = followed()
    assert at_once == [(100.0, 100.0)] + [(50.0, 50.0)] * 3
    # A part of a cycle is a cycle. Until the first command acts, they hold their shares.
    assert followed(delay_s=1.5) == [(50.0, 50.0)] * 2 + [(100.0, 100.0)] + [(50.0, 50.0)]
    assert [kw for kw, _ in followed(ramp_percent_per_s=20.0)] == [100.0, 80.0, 60.0, 50.0]
    assert [kw for kw, _ in followed(delay_s=1.0, ramp_percent_per_s=40.0)] == [60, 100, 60, 50]


@pytest.mark.parametrize("actuator", ["fraction", "limit"])
def test_an_inverter_that_hears_no_command_in_cycle_0_holds_its_share(actuator: str) -> None:
    plant = PlantAtWork(FLAT, actuator=actuator, cycle_wall_ns=CYCLE_NS)
    plant.begin()
    plant.at_deadline()
    assert powers_kw(plant.at_deadline()) == (50.0, 50.0)


def test_a_delay_and_a_revert_time_of_whole_cycles_take_these_and_not_one_more() -> None:
    """4.2 s are 6 cycles of 0.7 s, though 4.2 / 0.7 is a little more than 6."""
    common = {"cycle_ns": 700_000_000, "cycle_wall_ns": CYCLE_NS}
    for changes, expected_kw in (
        ({"delay_s": 4.2}, [50.0] * 6 + [20.0] * 3),
        ({"revert": Revert(after_s=4.2, to=0.3)}, [20.0] * 6 + [30.0] * 3),
    ):
        plant = PlantAtWork(FLAT, **common, **changes)
        plant.begin()
        found = []
        for cycle in range(9):
            plant.at_deadline()
            found.append(powers_kw(plant.command(0.2, 0.2) if not cycle else plant.at_deadline()))
        assert [kw for kw, _ in found] == expected_kw


@pytest.mark.parametrize("actuator", ["fraction", "limit"])
def test_a_fresh_command_undoes_a_revert(actuator: str) -> None:
    plant = PlantAtWork(
        FLAT, actuator=actuator, cycle_wall_ns=CYCLE_NS, revert=Revert(after_s=2.0, to=0.2)
    )
    plant.begin()
    found = []
    for cycle in range(6):
        plant.at_deadline()
        heard = cycle in {0, 4}
        sent = plant.command(0.7, 0.7, power_kw=(70.0, 70.0)) if heard else plant.at_deadline()
        found.append(powers_kw(sent))
    assert [kw for kw, _ in found] == [70.0] * 2 + [20.0] * 2 + [70.0] * 2


def test_cycles_that_were_missed_count_for_delays_ramps_and_reverts() -> None:
    plant = PlantAtWork(
        FLAT, cycle_wall_ns=CYCLE_NS, delay_s=3.0, revert=Revert(after_s=8.0, to=0.1)
    )
    plant.begin()
    plant.at_deadline()
    plant.command(0.4, 0.4)
    plant.loop.catch_up(6 * CYCLE_NS)
    plant.at_deadline()
    assert powers_kw(plant.at_deadline()) == (40.0, 40.0)
    plant.loop.catch_up(11 * CYCLE_NS)
    plant.at_deadline()
    assert powers_kw(plant.at_deadline()) == (10.0, 10.0)


def test_inverters_may_be_set_otherwise_and_the_last_entry_counts() -> None:
    settings = (
        InverterSettings(nodes="c1/*", delay_s=9.0, ramp_percent_per_s=20.0),
        InverterSettings(nodes="c1/a", delay_s=0.0),
    )
    assert followed(settings=settings) == [(100, 80), (80, 60), (60, 50), (50, 50)]


def test_each_inverter_reverts_after_its_own_time_to_its_own_limit() -> None:
    settings = (InverterSettings(nodes="c1/a", revert=Revert(after_s=2.0, to=0.2)),)
    plant = PlantAtWork(FLAT, cycle_wall_ns=CYCLE_NS, revert=Revert(4.0), settings=settings)
    plant.begin()
    found = []
    for cycle in range(7):
        plant.at_deadline()
        if cycle == 0:
            for leaf in LEAVES:
                message = Command(0, 0, leaf, (), alpha=0.5, power_kw=0.0, revert_kw=30.0)
                plant.loop.hear(COMMAND.of(leaf), message, 0)
            found.append(powers_kw(plant.sent()))
        else:
            found.append(powers_kw(plant.at_deadline()))
    assert [kw for kw, _ in found] == [50.0] * 2 + [20.0] * 5
    assert [kw for _, kw in found] == [50.0] * 4 + [30.0] * 3


def test_a_revert_forgets_commands_that_had_not_yet_taken_effect() -> None:
    plant = PlantAtWork(
        FLAT, cycle_wall_ns=CYCLE_NS, delay_s=2.0, revert=Revert(after_s=3.0, to=0.2)
    )
    plant.begin()
    found = []
    for cycle in range(8):
        plant.at_deadline()
        found.append(powers_kw(plant.command(0.5, 0.5) if cycle in {0, 6} else plant.at_deadline()))
    # The command of cycle 0 acts from cycle 2 on, is over in cycle 3, and that of 6 acts in 8.
    assert [kw for kw, _ in found] == [50.0] * 3 + [20.0] * 5


# Profiles ----------------------------------------------------------------------------------------


def test_what_is_no_profile_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "profile.npz"
    assert complaint_of(load_profile, path).startswith(f"{path}: ")
    path.write_bytes(b"nope")
    assert complaint_of(load_profile, path).startswith(f"{path}: ")
    np.savez_compressed(path, mpp_kw=np.zeros((2, 1)))
    assert complaint_of(load_profile, path).startswith(f"{path}: ")


def test_a_small_profile_that_would_fill_the_memory_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "profile.npz"
    Profile(np.zeros((2, 1)), np.zeros(2)).save(path)
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")  # Of the directory; the size stands at its byte 24.
    content[entry + 24 : entry + 28] = (3_000_000_000).to_bytes(4, "little")
    path.write_bytes(content)
    assert "3,000,0" in complaint_of(load_profile, path)
