"""Simulated inverters as SunSpec devices, read and limited by pysunspec2 and by our client."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from clock_by_hand import ClockByHand
from sunspec2.modbus.client import SunSpecModbusClientDeviceTCP as Device
from sunspec2.modbus.modbus import ModbusClientException

from sunspec.addresses import parse_address
from sunspec.client import SunSpecInverter, SunSpecMeter
from sunspec.modbus_tcp import DeviceError
from sunspec.registers import Points, inverter_points
from sunspec.server import Sky, served
from sunspec.simulated import LimitedInverter

RATING_KW = 100.0
SKY_KW = np.array([[80.0, 60.0], [90.0, 70.0]])
CYCLE_S = 1000.0


class Site:
    """Two inverters of 100 kW under a sky of 80 kW and 60 kW, and a clock to move."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self.clock = ClockByHand()
        self.addresses: dict[str, str] = {}
        self.sky: Sky

    def seconds(self) -> float:
        return self.clock.now_ns / 1e9

    def serve(
        self, *, waits: bool = False, delay_s: float = 0.0, ramp: float = inf, **where: Any
    ) -> dict[str, str]:
        self.sky = Sky(SKY_KW, CYCLE_S, None if waits else self.seconds())
        inverters = {
            name: LimitedInverter(RATING_KW, self.sky.available_kw(position), delay_s, ramp)
            for position, name in enumerate(("c1/a", "c1/b"))
        }
        serving = served(inverters, self.sky, self.seconds, **where)
        self.addresses = self._stack.enter_context(serving)
        return self.addresses

    def client(self, name: str = "c1/a") -> Device:
        host, port, unit = parse_address(self.addresses[name], name)
        device = Device(unit, host, port)
        device.scan()
        return device


@pytest.fixture
def site() -> Iterator[Site]:
    with ExitStack() as stack:
        yield Site(stack)


def watts(device: Device) -> float:
    model = device.models[103][0]
    model.read()
    return float(model.W.cvalue)


def limit_123(device: Device, percent: float, revert_s: int) -> None:
    model = device.models[123][0]
    model.WMaxLimPct.cvalue = percent
    model.WMaxLimPct_RvrtTms.cvalue = revert_s
    model.WMaxLim_Ena.value = 1
    model.write()


def limit_704(device: Device, percent: float, revert_s: int) -> None:
    model = device.models[704][0]
    model.WMaxLimPct.cvalue = percent
    model.WMaxLimPctRvrtTms.value = revert_s
    model.WMaxLimPctEnaRvrt.value = 0
    model.WMaxLimPctEna.value = 1
    model.write()


Limit = Callable[[Device, float, int], None]


@pytest.mark.parametrize("limit", [limit_123, limit_704])
def test_a_limit_acts_after_its_delay_along_its_ramp_and_reverts(site: Site, limit: Limit) -> None:
    site.serve(delay_s=2.0, ramp=10.0)
    device = site.client()
    assert watts(device) == 80_000
    limit(device, 50.0, 60)

    found = []
    for _ in range(6):
        site.clock.sleep(1.0)
        found.append(watts(device))
    assert found == [80_000, 80_000, 70_000, 60_000, 50_000, 50_000]

    site.clock.sleep(55.0)  # A second after the revert time: back along the ramp.
    assert watts(device) == 60_000
    site.clock.sleep(10.0)
    assert watts(device) == 80_000


def test_an_inverter_that_is_disconnected_stops_and_keeps_its_limit(site: Site) -> None:
    site.serve()
    device = site.client()
    limit_123(device, 50.0, 0)
    model, der, status = (device.models[number][0] for number in (123, 701, 122))
    model.Conn.value = 0
    model.write()
    assert watts(device) == 0
    assert device.models[103][0].St.value == 1
    der.read()
    status.read()
    assert (der.InvSt.value, der.ConnSt.value, status.WAval.cvalue) == (0, 0, 0)
    model.Conn.value = 1
    model.write()
    assert watts(device) == 50_000


def test_the_meter_adds_up_power_and_energy(site: Site) -> None:
    site.serve()
    limit_123(site.client("c1/a"), 40.0, 0)
    site.clock.sleep(360.0)
    device = site.client("meter")
    (meter,) = device.models[203]
    assert meter.W.cvalue == 100_000
    assert meter.TotWhExp.cvalue == 10_000
    # Also where the sky changes while nobody asks: from 1,000 s on there are 10 kW more.
    site.clock.sleep(1_000.0)
    meter.read()
    assert meter.W.cvalue == 110_000
    assert meter.TotWhExp.cvalue == pytest.approx(10_000 + 100_000 * 640 / 3600 + 11_000, abs=600)


def test_only_limits_can_be_written_and_only_in_their_range(site: Site) -> None:
    site.serve()
    device = site.client()
    model = device.models[123][0]
    model.WMaxLimPct.cvalue = 100.01
    with pytest.raises(ModbusClientException):
        model.write()
    settings = device.models[121][0]
    settings.WMax.cvalue = 1.0
    with pytest.raises(ModbusClientException):
        settings.write()
    assert watts(device) == 80_000


def test_the_sky_moves_on_and_may_wait_for_the_first_limit(site: Site) -> None:
    site.serve(waits=True)
    device = site.client("c1/b")
    site.clock.sleep(CYCLE_S + 1.0)
    assert watts(device) == 60_000
    limit_123(device, 100.0, 0)
    site.clock.sleep(CYCLE_S + 1.0)
    assert watts(device) == 70_000


# The gateway's client -----------------------------------------------------------------------------

OLD = (103, 120, 121, 122, 123)
NEW = (701, 702, 704)


def served_with(site: Site, models: Sequence[int], missing: Sequence[str] = ()) -> SunSpecInverter:
    """Serve inverters of some models that lack some points; return a client of c1/a."""

    def points(inverter: LimitedInverter, at: float) -> Points:
        return {
            model: {name: value for name, value in found.items() if name not in missing}
            for model, found in inverter_points(inverter, at).items()
            if model in models
        }

    return SunSpecInverter(site.serve(waits=True, points=points)["c1/a"])


@pytest.mark.parametrize("models", [OLD, NEW])
def test_each_family_of_models_is_read_and_limited(site: Site, models: Sequence[int]) -> None:
    inverter = served_with(site, models)
    inverter.connect()
    free = inverter.read()
    assert (inverter.rating_kw, free.power_kw, free.limit_kw) == (100.0, 80.0, 100.0)
    assert free.available_kw == 80.0

    inverter.set_power(30.0, 60.0, 20.0)
    limited = inverter.read()
    assert (limited.power_kw, limited.limit_kw, inverter.state) == (30.0, 30.0, "THROTTLED")
    # The newer models state no available power: only an inverter that is not throttled shows it.
    stated_kw = 80.0 if models is OLD else nan
    assert limited.available_kw == pytest.approx(stated_kw, nan_ok=True)

    site.clock.sleep(61.0)
    assert inverter.read().power_kw == (80.0 if models is OLD else 20.0)


@pytest.mark.parametrize(
    ("models", "without", "named"),
    [
        ((103, 121), (), "704 or 123"),
        ((704, 702), (), "701 or 103"),
        ((103, 123), (), "702"),
        (OLD, ("WMaxLimPct",), "WMaxLimPct in SunSpec model 123"),
    ],
)
def test_a_model_or_point_that_is_missing_is_named(
    site: Site, models: Sequence[int], without: Sequence[str], named: str
) -> None:
    inverter = served_with(site, models, without)
    with pytest.raises(DeviceError, match=named):
        inverter.connect()


@pytest.mark.parametrize(("ramp", "stated"), [(0.3, 1), (20.0, 20), (inf, None)])
def test_a_slow_ramp_is_not_stated_as_none(ramp: float, stated: int | None) -> None:
    inverter = LimitedInverter(100.0, lambda at: 80.0, ramp_percent_per_s=ramp)
    assert inverter_points(inverter, 0.0)[704].get("WRmp") == stated


def test_a_wrong_unit_what_is_no_meter_and_a_port_where_nobody_listens_are_named(
    site: Site,
) -> None:
    inverter = served_with(site, OLD)
    wrong = inverter.address.removesuffix("/1") + "/9"
    with pytest.raises(DeviceError, match="unit"):
        SunSpecInverter(wrong).connect()
    with pytest.raises(DeviceError, match="203"):
        SunSpecMeter(inverter.address).connect()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(DeviceError, match="refused"):
        SunSpecInverter(f"modbus://127.0.0.1:{port}/1").connect()
