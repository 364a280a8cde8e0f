"""What the plant's Modbus unit reads back, to a master of an independent library."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from order_desks import RATING_KW, SCHEDULED_KW, Giver, PlantByHand, plant_by_hand
from sunspec2.modbus.client import SunSpecModbusClientDeviceTCP as Master
from sunspec2.modbus.modbus import ModbusClientException

from bus_schemas.messages import Dispatch
from bus_schemas.tcp_ports import reserved_ports
from sunspec.plant_unit import served_unit

WATTS = ("WSetEna", "WSetMod", "WSet", "WSetRvrtTms", "WRmp")
PERCENT = ("WMaxLimPctEna", "WMaxLimPct", "WMaxLimPctRvrtTms", "WRmp")
READ = (*WATTS, *PERCENT, "WSetRvrtRem", "WMaxLimPctRvrtRem")


class Scada:
    """A master at the unit of a plant that the test drives, cycle by cycle."""

    def __init__(self, plant: PlantByHand, master: Master, folder: Path) -> None:
        self._plant, self._model = plant, master.models[704][0]
        self._other, self._last = Giver(folder), Giver(folder)

    def write(self, **points: int) -> None:
        self._last.arrive()  # Which of two programs' orders comes first is not for them to know.
        for name, value in points.items():
            self._model.points[name].cvalue = value
        self._model.write()  # Neighbours in one request.

    def order_otherwise(self, power_kw: float) -> None:
        self._last.arrive()
        self._other.give("page", power_kw)

    def go_on(self, cycles: int = 1) -> Dispatch:
        self._last.arrive()
        for _ in range(cycles):
            found = self._plant.go_on()
        return found

    def reads(self, **expected: int) -> bool:
        """Whether the unit soon reads so; it hears of a cycle a moment later."""
        until = time.monotonic() + 5.0
        while time.monotonic() < until:
            if self.read().items() >= expected.items():
                return True
        raise AssertionError(f"expected {expected}, got {self.read()}")

    def read(self) -> dict[str, int]:
        self._model.read()
        return {name: round(self._model.points[name].cvalue) for name in READ}


@pytest.fixture
def scada(tmp_path: Path) -> Iterator[Scada]:
    with plant_by_hand(tmp_path) as plant, unit(plant, tmp_path) as master:
        scada = Scada(plant, master, tmp_path)
        scada.go_on()
        until = time.monotonic() + 10.0
        while True:  # It takes orders once it has heard of the plant.
            try:
                scada.write(WRmp=0)
                break
            except ModbusClientException:
                assert time.monotonic() < until
                scada.go_on()
        yield scada


@contextmanager
def unit(plant: PlantByHand, folder: Path) -> Iterator[Master]:
    with reserved_ports(["unit"]) as ports:
        port = ports["unit"]
    with served_unit(plant.plan, folder, f"modbus://127.0.0.1:{port}"):
        master = Master(slave_id=1, ipaddr="127.0.0.1", ipport=port)
        master.scan()
        yield master
        master.close()


LIMIT: dict[str, int] = {"WMaxLimPctEna": 1, "WMaxLimPct": 30, "WMaxLimPctRvrtTms": 8}


def test_the_reversion_timer_counts_down_and_the_revert_clears_ena(scada: Scada) -> None:
    scada.write(**LIMIT)
    assert scada.go_on().power_kw == 0.3 * RATING_KW
    for rest in range(8, 0, -1):
        assert scada.reads(WMaxLimPctEna=1, WMaxLimPctRvrtRem=rest)
        dispatch = scada.go_on()
    assert dispatch.power_kw == SCHEDULED_KW
    assert scada.reads(WMaxLimPctEna=0, WMaxLimPct=30, WMaxLimPctRvrtRem=0)


def test_another_source_takes_over_and_a_timer_alone_does_not_pull_the_plant_back(
    scada: Scada,
) -> None:
    scada.write(**LIMIT)
    scada.go_on()
    scada.order_otherwise(150.0)
    assert scada.go_on().power_kw == 150.0
    assert scada.reads(WMaxLimPctEna=0, WMaxLimPctRvrtRem=0)
    scada.write(WMaxLimPctRvrtTms=60)
    assert scada.go_on(3).power_kw == 150.0
    scada.write(WMaxLimPctEna=1)
    assert scada.go_on().power_kw == 0.3 * RATING_KW
    assert scada.reads(WMaxLimPctEna=1, WMaxLimPctRvrtRem=60)


class UnitByHand:
    """What the unit should read, and the power that the plant should be asked for."""

    def __init__(self) -> None:
        self.registers = {**dict.fromkeys(READ, 0), "WSetMod": 1, "WMaxLimPct": 100}
        self.power_kw = SCHEDULED_KW
        self._hold_s = self._age_s = 0
        self._coming: tuple[float, int, bool] | None = None

    def write(self, points: dict[str, int]) -> None:
        had = self._kind()
        self.registers |= points
        if self.registers["WSetEna"] and self.registers["WMaxLimPctEna"]:
            self._disable("WMaxLimPctEna" if points.get("WSetEna") else "WSetEna")
        kind = self._kind()
        if kind == "WSet" and {*points} & {*WATTS}:
            power_kw = self.registers["WSet"] / 1e3
            self._coming = power_kw, self.registers["WSetRvrtTms"], True
        elif kind == "WMaxLimPct" and {*points} & {*PERCENT}:
            power_kw = self.registers["WMaxLimPct"] / 100 * RATING_KW
            self._coming = power_kw, self.registers["WMaxLimPctRvrtTms"], True
        elif had and not kind:
            self._coming = SCHEDULED_KW, 0, True

    def order_otherwise(self, power_kw: float) -> None:
        self._coming = power_kw, 0, False

    def go_on(self) -> None:
        self._age_s += 1
        if self._coming is not None:
            self.power_kw, self._hold_s, is_ours = self._coming
            self._age_s, self._coming = 0, None
            if not is_ours:
                self._disable("WSetEna", "WMaxLimPctEna")
        elif self._hold_s and self._age_s >= self._hold_s:
            self.power_kw, self._hold_s = SCHEDULED_KW, 0
            self._disable("WSetEna", "WMaxLimPctEna")
        for kind in ("WSet", "WMaxLimPct"):
            rest_s = max(self._hold_s - self._age_s, 0) if self._kind() == kind else 0
            self.registers[f"{kind}RvrtRem"] = rest_s

    def _kind(self) -> str:
        return next((one for one in ("WSet", "WMaxLimPct") if self.registers[f"{one}Ena"]), "")

    def _disable(self, *names: str) -> None:
        self.registers |= dict.fromkeys(names, 0)


def random_points(chance: random.Random) -> dict[str, int]:
    values: dict[str, Any] = {
        "WSetEna": chance.randrange(2),
        "WSetMod": 1,
        "WSet": chance.randrange(0, 200_000, 1_000),
        "WMaxLimPctEna": chance.randrange(2),
        "WMaxLimPct": chance.randrange(100),
        "WSetRvrtTms": chance.randrange(6),
        "WMaxLimPctRvrtTms": chance.randrange(6),
    }
    if chance.random() < 0.5:
        name = chance.choice([*values])
        return {name: values[name]}
    if chance.random() < 0.5:
        return {name: values[name] for name in ("WSetEna", "WSetMod", "WSet")}
    return {name: values[name] for name in ("WMaxLimPctEna", "WMaxLimPct")}


def test_500_random_sequences_of_writes_and_orders_read_back_what_is_in_force(
    scada: Scada,
) -> None:
    model, chance = UnitByHand(), random.Random(4)
    for number in range(500):
        done: list[object] = []
        for _ in range(4):
            done.append(points := random_points(chance))
            if chance.random() < 0.25:
                done[-1] = power_kw = float(chance.randrange(200))
                model.order_otherwise(power_kw)
                scada.order_otherwise(power_kw)
            else:
                model.write(points)
                scada.write(**points)
            for _ in range(cycles := chance.choice([0, 1, 1, 2, 4])):
                model.go_on()
            dispatch = scada.go_on(cycles) if cycles else None
            assert dispatch is None or dispatch.power_kw == model.power_kw, (number, done)
            if cycles:
                assert scada.reads(**model.registers), (number, done)
