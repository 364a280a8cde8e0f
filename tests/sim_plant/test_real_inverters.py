"""A plant whose inverters are real: what it says of one that is lost, with and without a meter."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import pytest
from plans_by_hand import CYCLE_NS, plan_of
from plants_by_hand import AtWork, at, command, memory

from agents.settings import Revert
from bus_schemas.messages import Command, Message, Production
from bus_schemas.signals import METER, PRODUCTION, TELEMETRY, Port
from bus_schemas.tree import ROOT
from sim_plant import real_inverters
from sim_plant.profile import Profile
from sim_plant.real_inverters import PlantWithDevices, Reading

LEAVES = ("c1/a", "c1/b")
CYCLES = 8
LOST_FROM = 3
"""The first cycle in which `c1/b` says nothing."""

LIMIT_KW, REVERT_KW, MAXIMUM_KW = 60.0, 30.0, 80.0


class Devices:
    """Two inverters that could give 80 kW and hold a limit of 60 kW; maybe a meter."""

    def __init__(self, metered_kw: float | None) -> None:
        self.lost: set[int] = set()
        self._readings = {
            position: Reading(0, LIMIT_KW, MAXIMUM_KW, LIMIT_KW) for position in (0, 1)
        }
        if metered_kw is not None:
            self._readings[real_inverters.METER_PLACE] = Reading(0, metered_kw)

    def newest(self) -> Mapping[int, Reading]:
        return self._readings

    def expired(self, cycle: int) -> Collection[int]:
        return self.lost

    def command(self, position: int, command: Command) -> None:
        pass


def cycles_of(metered_kw: float | None = None) -> list[dict[Port[Message], Message]]:
    """Run some cycles; return what the plant sends in each."""
    devices = Devices(metered_kw)
    plan = plan_of(
        dict.fromkeys(LEAVES, 100.0),
        cycles=CYCLES,
        actuator="limit",
        cycle_wall_ns=CYCLE_NS,
        revert=Revert(after_s=3.0),
        devices=tuple((leaf, "modbus://127.0.0.1") for leaf in LEAVES),
        meter="" if metered_kw is None else "modbus://127.0.0.1",
    )
    profile = Profile(np.full((CYCLES, 2), 99.0), np.full(CYCLES, 120.0))
    plant = AtWork(plan, PlantWithDevices(plan, profile, devices))
    sent = []
    for cycle in range(CYCLES):
        devices.lost = {1} if cycle >= LOST_FROM else set()
        now = plant.at_deadline("sense")
        commands = (command(leaf, cycle, LIMIT_KW / 100.0) for leaf in LEAVES)
        sent.append(now | plant.hear(memory(cycle), *commands))
    return sent


def production(sent: Mapping[Port[Message], Message]) -> Production:
    return at(sent, PRODUCTION.of(ROOT))


def metered_kw(sent: Mapping[Port[Message], Message]) -> float:
    return at(sent, METER.of(ROOT)).power_kw


def test_a_lost_inverter_leaves_meter_and_production_and_its_power_is_unknown() -> None:
    sent = cycles_of()
    before, after = sent[:LOST_FROM], sent[LOST_FROM:]
    assert {metered_kw(one) for one in before[1:]} == {120.0}
    assert {metered_kw(one) for one in after} == {60.0}
    assert all((TELEMETRY.of("c1/b") in one) == (one in before) for one in sent)
    assert {production(one).delivered_kw for one in after} == {60.0}
    assert {production(one).inverter_power_kw for one in after} == {(60.0, 0.0)}
    assert {production(one).available_kw for one in after} == {MAXIMUM_KW}
    # The plant assumes that it holds its limit, and reverts 3 s after its last command.
    unknown_kw = [production(one).unknown_kw for one in sent]
    assert unknown_kw == [0.0] * LOST_FROM + [LIMIT_KW] * 2 + [REVERT_KW] * 3


@pytest.mark.parametrize("reading_kw", [60.0, 117.0])
def test_a_real_meter_ends_the_guessing(reading_kw: float) -> None:
    for sent in cycles_of(reading_kw):
        assert metered_kw(sent) == production(sent).delivered_kw == reading_kw
        assert production(sent).unknown_kw == 0.0
