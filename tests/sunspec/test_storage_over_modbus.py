"""Storages over Modbus: served to an outsider, driven by a run, and such as do not do as told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import command_line
import numpy as np
import pytest
from clock_by_hand import ClockByHand
from quirky import quirky, storage
from running import Start, small_plant
from sunspec2.modbus.client import SunSpecModbusClientDeviceTCP as Outsider
from sunspec2.modbus.modbus import ModbusClientException
from test_launched_with_devices import inverters

from agents.settings import StorageSettings
from recordings.read.reader import RunReader
from recordings.read.series import RunSeries, plant_series_of
from sunspec.addresses import parse_address
from sunspec.client import SunSpecStorage
from sunspec.modbus_tcp import DeviceError
from sunspec.process import read_accounts
from sunspec.server import Sky, served
from sunspec.simulated import SetStorage

TABLE = """
[[storage]]
name = "battery"
rating_kw = 100
capacity_kwh = 50
state = 0.5
target = 0.5
"""


def outsider(address: str) -> Outsider:
    host, port, unit = parse_address(address, "")
    device = Outsider(unit, host, port)
    device.scan()
    return device


def test_an_outsider_reads_a_served_storage_and_gives_it_powers() -> None:
    clock = ClockByHand()
    battery = StorageSettings(
        name="battery", rating_kw=100.0, capacity_kwh=50.0, state=0.5, delay_s=1.0,
        ramp_percent_per_s=50.0, charge_efficiency=0.9, discharge_efficiency=0.8,
    )  # fmt: skip
    sky = Sky(np.zeros((1, 0)), 1.0, 0.0)
    with served({"battery": SetStorage(battery)}, sky, lambda: clock.now_ns / 1e9) as addresses:
        device = outsider(addresses["battery"])
        power, rating, control, store, dc = (
            device.models[number][0] for number in (701, 702, 704, 713, 714)
        )
        assert (rating.WChaRteMax.cvalue, rating.WDisChaRteMax.cvalue) == (100_000, 100_000)
        assert (store.WHRtg.cvalue, store.WHAvail.cvalue, store.SoC.cvalue) == (50_000, 25_000, 50)

        def read() -> tuple[float, float]:
            power.read()
            store.read()
            return power.W.cvalue / 1e3, store.SoC.cvalue

        control.WSetEna.value, control.WSetMod.value, control.WSet.cvalue = 1, 1, -60_000
        control.WSetEnaRvrt.value, control.WSetRvrt.cvalue, control.WSetRvrtTms.value = 1, 0, 60
        control.write()
        found = []
        for _ in range(4):
            clock.sleep(1.0)
            found.append(read()[0])
        assert found == [0.0, -50.0, -60.0, -60.0]
        dc.read()
        assert dc.DCW.cvalue == pytest.approx(-54_000)
        clock.sleep(55.0)
        charged_kwh = (50.0 + 57 * 60.0) / 3600.0 * 0.9
        assert read() == pytest.approx((-60.0, 50.0 + 2.0 * charged_kwh), abs=0.01)
        clock.sleep(4.0)
        assert read()[0] == 0.0, "it has reverted"
        meter = outsider(addresses["meter"]).models[203][0]
        assert not meter.TotWhExp.cvalue
        assert meter.TotWhImp.cvalue == 1_000

        control.WSetEna.value, control.WSet.cvalue, control.WSetRvrtTms.value = 1, 100_000, 0
        control.write()
        clock.sleep(3600.0)
        assert read() == (0.0, 10.0), "it is empty, down to its lowest state"
        control.WSet.cvalue = 100_001
        with pytest.raises(ModbusClientException):
            control.write()
        meter.read()
        assert meter.TotWhExp.cvalue > 0
        assert meter.TotWhImp.cvalue == 1_000, "no counter runs backwards"


def test_state_and_power_come_from_the_models_that_there_are() -> None:
    old = storage()
    del old[713], old[701]
    with quirky(
        models=old
        | {
            714: {"DCW_SF": 1, "DCW": -200},
            802: {"WHRtg_SF": 2, "WHRtg": 500, "SoC_SF": -1, "SoC": 405, "State": 3},
        }
    ) as device:
        client = SunSpecStorage(device.address)
        client.connect()
        reading = client.read()
        assert (reading.power_kw, reading.energy_kwh) == pytest.approx((-2.0, 20.25))
        assert (client.rating_kw, client.capacity_kwh) == (100.0, 50.0)
        device.state(802, State=99)
        with pytest.raises(DeviceError, match="FAULT"):
            client.read()
    with quirky(models=storage(store={"WHAvail": 2_400})) as device:
        client = SunSpecStorage(device.address)
        client.connect()
        assert client.read().energy_kwh == 24.0


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"store": {"SoC": None}}, "SoC in SunSpec model 713"),
        ({"store": {"WH_SF": None}}, "WH_SF in SunSpec model 713"),
        ({"control": {"WSet": None}}, "WSet in SunSpec model 704"),
        ({"control": {"WSetRvrtTms": None}}, "WSetRvrtTms in SunSpec model 704"),
    ],
)
def test_a_point_that_is_not_implemented_is_named(changes: dict[str, Any], named: str) -> None:
    with quirky(models=storage(**changes)) as device, pytest.raises(DeviceError, match=named):
        SunSpecStorage(device.address).connect()


def scenario_of(folder: Path, *tables: str, share: str = "1.2") -> str:
    path = small_plant(
        folder,
        ("share = 0.5", f"share = {share}"),
        ("[irradiance]", 'actuator = "limit"\n\n[irradiance]'),
    )
    with Path(path).open("a", encoding="utf-8") as file:
        file.writelines(tables)
    return path


def series(folder: Path) -> RunSeries:
    with RunReader(folder) as reader:
        return plant_series_of(reader)


@pytest.mark.processes
def test_a_run_drives_a_served_storage_as_it_does_a_simulated_one(
    tmp_path: Path, heliarch: Start
) -> None:
    scenario = scenario_of(tmp_path / "scenario", TABLE)
    span = ("launch", scenario, "--pace", "1", "--duration", "12s")
    with inverters(scenario) as options:
        (battery,) = [f"--device={one}" for one in options if one.startswith("battery=")]
        plain, real = heliarch(*span), heliarch(*span, battery)
        assert (plain.wait(), real.wait()) == (0, 0), real.error_text()
    expected, found = (series(run.folder) for run in (plain, real))
    assert (expected.storage_power_kw[4:] > 90.0).all(), "the sky never has enough"
    np.testing.assert_allclose(found.storage_power_kw[5:], expected.storage_power_kw[5:], rtol=0.02)
    np.testing.assert_allclose(found.power_kw, expected.power_kw)
    (account,) = read_accounts(real.folder)
    assert account.node == "battery"
    assert account.writes.count
    assert account.excess_kw == 0.0


@pytest.mark.processes
def test_storages_that_fail_are_named_and_the_inverters_keep_their_promise(
    tmp_path: Path, heliarch: Start
) -> None:
    names = ("ignores", "dies", "forgets")
    tables = [TABLE.replace("battery", name) for name in names]
    scenario = scenario_of(tmp_path / "scenario", *tables)
    alone = scenario_of(tmp_path / "alone")
    span = ("--duration", "24")
    models = storage()
    with (
        quirky(models=models) as ignores,
        quirky(models=models) as dies,
        quirky(models=models) as forgets,
    ):
        devices = zip(names, (ignores, dies, forgets), strict=True)
        options = [f"--device={name}={one.address}" for name, one in devices]
        hold = ("--set", "control.hold_cycles=3")
        run = heliarch("launch", scenario, "--pace", "1", *span, *hold, *options)
        run.until_recorded(8)
        dies.__exit__()
        forgets.state(713, SoC=None)
        assert run.wait() == 0, run.error_text()
    said = " ".join(run.output.read_text().split())
    assert "ignores: gives 0 kW" in said
    assert "forgets: modbus" in said
    assert "it states no energy WHAvail or SoC" in said
    assert "dies: modbus" in said
    accounts = {account.node: account for account in read_accounts(run.folder)}
    assert accounts["ignores"].excess_kw == pytest.approx(100.0, abs=20.0)
    assert accounts["dies"].gone_s is not None
    assert accounts["forgets"].refused
    summary = json.loads((run.folder / "summary.json").read_text())
    assert summary["messages_lost"] == 0

    reference = tmp_path / "reference"
    words = ("simulate", alone, *span, "--out", reference)
    assert command_line.heliarch(*words).exit_code == 0
    with_them, without = series(run.folder), series(reference)
    assert (with_them.power_kw.sum(axis=1) >= without.power_kw.sum(axis=1) - 1e-6).all()
    assert (with_them.storage_power_kw == 0.0).all()
