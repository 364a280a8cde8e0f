"""A plant takes a step of its dispatch without overshoot, however slowly its inverters follow."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plans_by_hand import plan_of

from agents.plan import RunPlan
from agents.settings import Revert
from bus_schemas.messages import Command, Message, Production
from bus_schemas.signals import Port
from launch_scripts.simulation import MemoryRun, on_the_clock
from scenarios.fault_rules import parse_fault
from sim_plant.plant import Plant
from sim_plant.profile import Profile
from sim_plant.real_inverters import PlantWithDevices, Reading
from sunspec.simulated import LimitedInverter, LimitSettings

INVERTERS = {f"c{cluster}/{name}": 500.0 for cluster in (1, 2) for name in "abcd"}
RATING_KW = sum(INVERTERS.values())
SUN_KW = 450.0
"""What each inverter could give."""

UP_AT, DOWN_AT, CYCLES = 30, 90, 150
LOW_KW, HIGH_KW = 0.25 * RATING_KW, 0.55 * RATING_KW
"""A step of 30 % of the rating, up and down again."""

Values = NDArray[np.float64]


def powers_kw(
    rules: Collection[str] = (), real: dict[str, Any] | None = None, **changes: Any
) -> Values:
    """What each inverter delivers in each cycle; if `real` is given, real ones of that kind."""
    law = {"scheme": "predictive", "actuator": "limit", "correction": True}
    faults = tuple(map(parse_fault, rules))
    plan = plan_of(INVERTERS, cycles=CYCLES, faults=faults, **{**law, **changes})
    if real is not None:
        devices = tuple((leaf, "modbus://127.0.0.1") for leaf in INVERTERS)
        plan = plan_of(INVERTERS, cycles=CYCLES, devices=devices, **law, **real)
    commitment_kw = np.full(CYCLES, LOW_KW)
    commitment_kw[UP_AT:DOWN_AT] = HIGH_KW
    profile = Profile(np.full((CYCLES, len(INVERTERS)), SUN_KW), commitment_kw)
    found: list[tuple[float, ...]] = []

    def see(port: Port[Message], message: Message) -> None:
        if isinstance(message, Production):
            found.append(message.inverter_power_kw)

    plant = Plant if real is None else plant_of_real_inverters
    run = MemoryRun(on_the_clock(plan) if rules else plan, profile, see, make_plant=plant)
    assert len([*run.cycles()]) == CYCLES
    return np.array(found)


class ServedInverters:
    """Inverters that hear a command early in a cycle, and are read late in it."""

    def __init__(self, plan: RunPlan) -> None:
        self._inverters = []
        for leaf in plan.tree.leaves:
            one = plan.site.settings_of(leaf)
            rating_kw, ramp = plan.tree.rating_kw(leaf), one.ramp_percent_per_s or np.inf
            self._inverters.append(
                LimitedInverter(rating_kw, lambda _: SUN_KW, one.delay_s or 0.0, ramp)
            )
        self._readings: dict[int, Reading] = {}
        self._read_at: float | None = 0.0

    def newest(self) -> Mapping[int, Reading]:
        if self._read_at is not None:
            for position, one in enumerate(self._inverters):
                limit_kw = one.settings.target / 100.0 * one.rating_kw
                one.advance(self._read_at)
                power_kw = one.power_kw(self._read_at)
                self._readings[position] = Reading(0, power_kw, SUN_KW, limit_kw)
            self._read_at = None
        return self._readings

    def expired(self, cycle: int) -> Collection[int]:
        return ()

    def command(self, position: int, command: Command) -> None:
        one = self._inverters[position]
        percent = 100.0 * command.power_kw / one.rating_kw
        one.apply(LimitSettings(enabled=True, percent=percent), command.cycle + 0.1)
        self._read_at = command.cycle + 0.75


def plant_of_real_inverters(plan: RunPlan, profile: Profile) -> Plant:
    return PlantWithDevices(plan, profile, ServedInverters(plan))


def assert_a_clean_step(powers_kw: Values, settled_in_s: int) -> None:
    """Up and down: no overshoot, and settled, within 1 % of the rating."""
    power_kw, near_kw = powers_kw.sum(axis=1), 0.01 * RATING_KW
    _, up_kw, down_kw = np.split(power_kw, [UP_AT, DOWN_AT])
    assert up_kw.max() < HIGH_KW + near_kw
    assert down_kw.min() > LOW_KW - near_kw
    assert up_kw[settled_in_s:] == pytest.approx(HIGH_KW, abs=near_kw)
    assert down_kw[settled_in_s:] == pytest.approx(LOW_KW, abs=near_kw)


@pytest.mark.parametrize(
    "follows", [{}, {"delay_s": 1.0, "ramp_percent_per_s": 20.0}, {"delay_s": 3.0}], ids=str
)
def test_real_inverters_that_are_read_late(follows: dict[str, Any]) -> None:
    takes_s = follows.get("delay_s", 0.0) + 100.0 / follows.get("ramp_percent_per_s", np.inf)
    assert_a_clean_step(powers_kw(real=follows), round(takes_s) + 6)


@pytest.mark.parametrize("follows", [{"delay_s": 1.0, "ramp_percent_per_s": 10.0}], ids=str)
@pytest.mark.parametrize("at", ["25s..45s", "80s..100s"])
@pytest.mark.parametrize("gone", ["central|c1", "c1|c1/a", "plant|central"])
def test_a_link_that_comes_back_around_a_step(gone: str, at: str, follows: dict[str, Any]) -> None:
    rules = [f"partition={gone},at={at}"]
    found_kw = powers_kw(rules, **follows).sum(axis=1)
    paper_kw = powers_kw(rules, scheme="paper", correction=False, **follows).sum(axis=1)
    for cycles, ahead, to_kw in (
        (slice(UP_AT), 1.0, LOW_KW),
        (slice(UP_AT, DOWN_AT), 1.0, HIGH_KW),
        (slice(DOWN_AT, None), -1.0, LOW_KW),
    ):
        by_paper_kw = max((ahead * (paper_kw[cycles] - to_kw)).max(), 0.0)
        assert (ahead * (found_kw[cycles] - to_kw)).max() < by_paper_kw + 0.005 * RATING_KW


@pytest.mark.parametrize("gone", ["0s..30s", "20s..50s"], ids=["never seen", "seen before"])
def test_an_inverter_that_reverted_to_nothing_is_probed_until_it_is_seen(gone: str) -> None:
    rule, revert = f"partition=c1/a|plant,at={gone}", Revert(after_s=5.0, to=0.0)
    found_kw = powers_kw([rule], revert=revert)[:, 0]
    assert found_kw[29] == 0.0
    assert found_kw[-1] > 0.9 * LOW_KW / len(INVERTERS)
