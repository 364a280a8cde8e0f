"""The plant as one SunSpec unit, read and ordered by a master of an independent library."""

from __future__ import annotations

import json
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import psutil
import pytest
from command_line import done, refusal
from running import REPOSITORY, Device, Heliarch, Start, small_plant
from sunspec2.modbus.client import SunSpecModbusClientDeviceTCP as Master

from bus_schemas.errors import FailureError
from bus_schemas.messages import Dispatch
from bus_schemas.signals import DISPATCH
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import OPERATOR
from recordings.read.reader import RunReader
from recordings.verify.verification import verify
from sunspec.process import PlantUnitProcess

pytestmark = pytest.mark.processes

WAIT_S = 60.0


@contextmanager
def master(port: int) -> Iterator[Master]:
    """A SunSpec master that has found the models of the unit."""
    device = Master(slave_id=1, ipaddr="127.0.0.1", ipport=port)
    device.scan()
    yield device
    device.close()


def until(condition: Callable[[], bool], what: str) -> None:
    give_up_at = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < give_up_at, what
        time.sleep(0.1)


def power_kw(device: Master) -> float:
    model = device.models[701][0]
    model.read()
    return float(model.points["W"].cvalue) / 1e3


def dispatches_of(run: Heliarch) -> list[Dispatch]:
    with RunReader(run.folder) as reader:
        found = [message for _, message in reader.messages(DISPATCH)]
    return [message for message in found if isinstance(message, Dispatch)]


def test_a_master_reads_the_plant_orders_a_power_with_a_ramp_and_it_reverts(
    heliarch: Start, plant: str
) -> None:
    with reserved_ports(["unit"]) as ports:
        port = ports["unit"]
    words = ("--pace", "1", "--duration", "1h", "--scheme", "paper")
    run = heliarch("launch", plant, *words, "--operator", f"modbus://127.0.0.1:{port}")
    run.until_running()
    with master(port) as device:
        assert {1, 701, 702, 203, 704} <= device.models.keys()
        assert device.models[702][0].points["WMaxRtg"].cvalue == 1_900_000
        until(lambda: power_kw(device) > 500.0, "a power of the plant")
        control = device.models[704][0]
        control.points["WSet"].cvalue = 400_000
        control.points["WSetMod"].cvalue = 1
        control.points["WSetEna"].cvalue = 1
        control.points["WSetRvrtTms"].cvalue = 6
        control.points["WRmp"].cvalue = 20
        control.write()
        until(lambda: abs(power_kw(device) - 400.0) < 1.0, "the power that was ordered")
        until(lambda: power_kw(device) > 500.0, "the schedule, since nothing was written again")
        meter = device.models[203][0]
        meter.read()
        assert meter.points["W"].cvalue > 500_000
        control.points["WSet"].cvalue = 1_900_001
        with pytest.raises(Exception, match=r"[Ee]xception|3"):
            control.points["WSet"].write()
    run.interrupt()
    dispatches = dispatches_of(run)
    states = {message.order_state for message in dispatches if message.order_source == "modbus"}
    assert states == {"holds", "silent", "over"}
    ramp_kw = [message.power_kw for message in dispatches if message.order_state == "holds"]
    steps = [abs(after - before) for before, after in pairwise(ramp_kw)]
    assert max(steps) <= 0.2 * 1900.0 + 1e-6
    assert verify(run.folder).equal


def test_the_end_of_the_units_process_is_named_and_the_run_goes_on(
    heliarch: Start, plant: str
) -> None:
    with reserved_ports(["unit"]) as ports:
        address = f"modbus://127.0.0.1:{ports['unit']}"
    run = heliarch("launch", plant, "--pace", "10", "--duration", "60", "--operator", address)
    run.until_running()
    (unit,) = [
        process
        for process in psutil.Process(run.process.pid).children()
        if "sunspec.plant_unit" in process.cmdline()
    ]
    unit.kill()
    assert run.wait() == 1
    assert "Modbus unit" in run.error_text()
    document = json.loads((run.folder / "summary.json").read_bytes())
    assert (document["cycles"], [*document["given_up"]]) == (60, ["Modbus unit"])


@pytest.mark.soak
def test_orders_come_by_all_five_ways_in_one_run_and_verify_repeats_it(
    heliarch: Start, device: Device, tmp_path: Path
) -> None:
    scenario = small_plant(
        tmp_path / "ordered", ("[time]", "orders = [{ at = 5, power_kw = 500 }]\n\n[time]")
    )
    done("keys", scenario, "--out", tmp_path / "keys")
    with reserved_ports(["unit"]) as ports:
        unit = ports["unit"]
    run = heliarch(
        *("launch", scenario, "--pace", "1", "--duration", "10m", "--scheme", "paper"),
        *("--secure", "--keys", tmp_path / "keys", "--external", OPERATOR),
        *("--page", "--orders", "--operator", f"modbus://127.0.0.1:{unit}"),
    )
    plan = run.folder / "plan.json"
    device(REPOSITORY / "examples" / "agc.py", "--plan", plan, "--duration", "20")
    page, _, token = run.until_said("page: ").split()[0].partition("?token=")
    run.until_recorded(30)
    assert "400 kW reached" in done("order", run.folder, "400kW")
    headers = {"Origin": page.removesuffix("/"), "Content-Type": "application/json"}
    headers |= {"Cookie": f"heliarch-page-{page.rstrip('/').rpartition(':')[2]}={token}"}
    request = urllib.request.Request(f"{page}order", b'{"power_kw": 450}', headers)
    with urllib.request.urlopen(request, timeout=WAIT_S) as answer:
        assert b"450 kW reached" in answer.read()
    with master(unit) as scada:
        control = scada.models[704][0]
        for name, value in {"WSet": 550_000, "WSetMod": 1, "WSetEna": 1}.items():
            control.points[name].cvalue = value
        control.write()
        until(lambda: abs(power_kw(scada) - 550.0) < 1.0, "the power that was ordered")
    run.interrupt()
    dispatches = dispatches_of(run)
    named = {one.order_source for one in dispatches} - {""}
    # The program's order of the same cycle counts more than the scenario's.
    named |= {source for one in dispatches for source in one.order_replaced}
    assert named == {"scenario", OPERATOR, "command", "page", "modbus"}
    assert verify(run.folder).equal


@pytest.mark.parametrize("address", ["127.0.0.1:5030", "modbus://127.0.0.1:5030/300", "moon"])
def test_an_address_that_cannot_be_is_refused(plant: str, address: str) -> None:
    assert "--operator" in refusal("launch", plant, "--operator", address)


def test_a_unit_that_dies_at_its_start_is_named_with_its_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text("import os\nos._exit(3)\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(FailureError, match="status 3"):
        PlantUnitProcess("modbus://127.0.0.1:0", tmp_path)
