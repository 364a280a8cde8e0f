"""The gateway between a run's plant and inverters over Modbus."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
from plans_by_hand import plan_of, with_changes

from agents.plan import RunPlan
from agents.settings import Revert
from bus_schemas.messages import Command
from sim_plant.real_inverters import Reading
from sunspec.addresses import parse_address
from sunspec.gateway import Gateway
from sunspec.pipes import PlantPipes
from sunspec.process import read_accounts
from sunspec.server import Sky, served
from sunspec.simulated import LimitedInverter

PLAN = plan_of({"c1/a": 100.0}, actuator="limit", cycle_ns=50_000_000, cycle_wall_ns=50_000_000)


def one_inverter(
    port: int = 0, kind: type[LimitedInverter] = LimitedInverter
) -> AbstractContextManager[dict[str, str]]:
    """Serve an inverter of 100 kW that could give 80 kW."""
    sky = Sky(np.array([[80.0]]), 1.0, None)
    return served({"c1/a": kind(100.0, sky.available_kw(0))}, sky, time.monotonic, port=port)


def with_device(address: str, **site: Revert) -> RunPlan:
    return with_changes(PLAN, devices=(("c1/a", address),), **site)


@contextmanager
def gateway(plan: RunPlan, folder: Path) -> Iterator[tuple[PlantPipes, list[str]]]:
    """Run a gateway; yield the plant's end, and the list of the gateway's messages."""
    messages: list[str] = []
    until, end = os.pipe()
    found = Gateway(plan, messages.append)
    thread = threading.Thread(target=found.serve, args=(folder, until))
    thread.start()
    try:
        eventually(lambda: bool(messages))
        yield PlantPipes(plan, folder), messages
    finally:
        os.close(end)
        thread.join()
        os.close(until)


def eventually(condition: Callable[[], bool]) -> None:
    give_up_at = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < give_up_at
        time.sleep(0.005)


def newest(devices: PlantPipes) -> Reading:
    return devices.newest()[0]


def command(cycle: int, kw: float) -> Command:
    return Command(cycle, 0, "c1/a", (), alpha=kw / 80.0, power_kw=kw)


def test_readings_and_commands_pass_and_are_measured(tmp_path: Path) -> None:
    with (
        one_inverter() as addresses,
        gateway(with_device(addresses["c1/a"]), tmp_path) as (devices, _),
    ):
        assert newest(devices).power_kw == 80.0
        devices.command(0, command(0, 30.0))
        eventually(lambda: newest(devices).power_kw == 30.0)
        assert newest(devices).limit_kw == 30.0
        # The same limit again is no news to the inverter, and its revert time is long.
        devices.command(0, command(1, 30.0))
        devices.command(0, command(2, 40.0))
        eventually(lambda: newest(devices).power_kw == 40.0)
    (account,) = read_accounts(tmp_path)
    assert account.node == "c1/a"
    assert account.reads.count >= 2
    assert account.writes.count == 2
    assert 0.0 < account.reads.p50_ms <= account.reads.p99_ms
    assert not list(tmp_path.glob("device-*"))


def test_a_limit_is_renewed_only_as_long_as_it_is_commanded(tmp_path: Path) -> None:
    plan = with_device("", revert=Revert(after_s=1.0, to="release"))
    with one_inverter() as addresses:
        plan = with_changes(plan, devices=(("c1/a", addresses["c1/a"]),))
        with gateway(plan, tmp_path) as (devices, _):
            until = time.monotonic() + 1.5
            cycle = 0
            while time.monotonic() < until:
                devices.command(0, command(cycle, 30.0))
                cycle += 1
                time.sleep(0.05)
            eventually(lambda: newest(devices).power_kw == 30.0)
            eventually(lambda: newest(devices).power_kw == 80.0)
    (account,) = read_accounts(tmp_path)
    assert 2 <= account.writes.count < cycle


def test_an_inverter_that_goes_and_comes_back_is_limited_again(tmp_path: Path) -> None:
    with one_inverter() as addresses:
        address = addresses["c1/a"]
        port = parse_address(address, "")[1]
        running = gateway(with_device(address), tmp_path)
        devices, messages = running.__enter__()
        devices.command(0, command(0, 30.0))
        eventually(lambda: newest(devices).power_kw == 30.0)
    eventually(lambda: any(messages))
    eventually(lambda: devices.expired(1) == {0})
    with one_inverter(port):  # It comes back without its limit.
        eventually(lambda: newest(devices).power_kw == 80.0 and not devices.expired(1))
        devices.command(0, command(1, 30.0))
        eventually(lambda: newest(devices).power_kw == 30.0)
        running.__exit__(None, None, None)
    (account,) = read_accounts(tmp_path)
    assert (account.breaks, account.gone_s) == (1, None)
