"""The example controller does as docs/wire.md says where an input does not come in time."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgpack
import pytest
import zenoh

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))

import direct_controller

from bus_schemas.codec import decode
from bus_schemas.links import explicit_links
from bus_schemas.messages import Command
from bus_schemas.signals import COMMAND
from bus_schemas.tree import ControlTree

NODE = "c1/inv01"
CYCLE_S = 2.0
PLAN: dict[str, Any] = {
    "plant": "field",
    "namespace": "",
    "run_id": "run-1",
    "address": "127.0.0.1",
    "inverters": [[NODE, 100.0], ["c1/inv02", 100.0]],
    "tcp_ports": {"recorder": 7500, "plant": 7501, "central": 7502, "c1": 7503},
    "start_time_ns": 0,
    "cycle_ns": 1_000_000_000,
    "cycles": 1_000,
    "cycle_wall_ns": int(CYCLE_S * 1e9),
    "period_cycles": [1, 5],
    "alpha_min": 0.05,
    "hold_cycles": 2,
}


class Device:
    """The controller at work on a clock of the test's, and what it sends."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **plan: Any) -> None:
        self.now_s = 100.0
        self.sent: list[tuple[str, dict[str, Any]]] = []
        clock = SimpleNamespace(monotonic=lambda: self.now_s, monotonic_ns=lambda: 1)
        monkeypatch.setattr(direct_controller, "time", clock)
        session = cast("zenoh.Session", SimpleNamespace(put=self._put))
        self.controller = direct_controller.DirectController(PLAN | plan, NODE, session)

    def _put(self, key: str, payload: bytes, **options: object) -> None:
        self.sent.append((key.removeprefix(f"field/{NODE}/"), msgpack.unpackb(payload)))

    def hear(self, signal: str, cycle: int, **fields: float) -> list[str]:
        """Let a message come; return the signals with which it is answered."""
        before = len(self.sent)
        self.controller.hear(signal, {"cycle": cycle} | fields)
        return [name for name, _ in self.sent[before:]]

    def measure(self, cycle: int) -> list[str]:
        return self.hear("telemetry", cycle, power_kw=60.0, alpha=1.0)

    def dispatch(self, cycle: int, power_kw: float = 100.0) -> list[str]:
        return self.hear("dispatch", cycle, power_kw=power_kw, plant_rating_kw=200.0)

    def last(self) -> dict[str, Any]:
        """Return the message that was sent last."""
        return self.sent[-1][1]

    def wait(self) -> tuple[float, list[str]]:
        """Let nothing come for as long as it waits: how long that is, and what it then says."""
        left_s, before = self.controller.seconds_left(), len(self.sent)
        assert left_s is not None, "it would wait for ever"
        self.now_s += left_s
        self.controller.advance(time_is_up=True)
        return round(left_s, 9), [name for name, _ in self.sent[before:]]


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Device:
    return Device(monkeypatch)


def test_without_a_setpoint_in_time_the_last_one_is_commanded(device: Device) -> None:
    device.measure(0)
    assert device.dispatch(0) == ["impp", "residual"]
    assert device.hear("setpoint", 0, power_kw=30.0) == ["command"]
    assert device.controller.seconds_left() is None
    device.measure(5)
    device.dispatch(5)
    assert device.wait() == (0.7 * CYCLE_S, ["command"])
    command = device.last()
    assert (command["cycle"], command["alpha"], command["missing"]) == (
        5,
        0.5,
        [f"{NODE}/setpoint@0"],
    )
    assert isinstance(decode(COMMAND, msgpack.packb(command)), Command)
    assert device.hear("setpoint", 5, power_kw=15.0) == [], "it comes too late for this cycle"
    device.measure(6)
    device.dispatch(6)
    assert (device.last()["alpha"], device.last()["missing"]) == (0.25, [])


def test_it_counts_the_cycles_that_it_controlled_and_no_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    device = Device(monkeypatch, cycle_wall_ns=0)
    for cycle in (-2, -1, 68, 69, 70):  # It comes into a run under way.
        device.measure(cycle)
        device.dispatch(cycle)
        device.hear("setpoint", cycle, power_kw=30.0)
    assert [name for name, _ in device.sent].count("command") == 5
    assert device.controller.commands == 3


def test_it_answers_the_test_vector_of_the_documents(monkeypatch: pytest.MonkeyPatch) -> None:
    text = (Path(__file__).parents[2] / "docs" / "own-device.md").read_text(encoding="utf-8")
    table = text.partition("<!-- table: vector -->")[2].partition("<!-- end -->")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line[2:3].isdigit()]
    assert len(rows) > 5
    rating_kw = 8_000.0 / 17.0
    device = Device(
        monkeypatch,
        inverters=[[NODE, rating_kw], ["c1/inv02", 8_000.0 - rating_kw]],
        period_cycles=[1, 1],
    )
    for cycle, row in enumerate(rows):
        telemetry, dispatch, setpoint, *answers = (
            [] if cell == "-" else list(map(float, cell.split())) for cell in row[1:]
        )
        if telemetry:
            fields = dict(zip(("power_kw", "alpha", "available_kw"), telemetry, strict=False))
            device.hear("telemetry", cycle, **fields)
        if dispatch:
            device.hear("dispatch", cycle, power_kw=dispatch[0], plant_rating_kw=8_000.0)
        if not (telemetry and dispatch):
            device.wait()
        if setpoint:
            device.hear("setpoint", cycle, power_kw=setpoint[0])
        else:
            device.wait()
        sent = {name: message for name, message in device.sent if message["cycle"] == cycle}
        impp, residual, command = sent["impp"], sent["residual"], sent["command"]
        assert answers == [
            [impp["power_kw"], impp["stale_cycles"]],
            [residual["power_kw"]],
            [command["alpha"], command["power_kw"]],
        ]


def test_it_listens_nowhere_and_connects_where_its_links_are() -> None:
    ports = PLAN["tcp_ports"] | {"c1+standby": 7504}
    found = direct_controller.session_config(PLAN | {"tcp_ports": ports}, NODE, [])
    assert found.get_json("listen/endpoints") == "[]"
    tree = ControlTree(tuple((path, kw) for path, kw in PLAN["inverters"]))
    listens, connects = explicit_links(tree, ["c1"]).endpoints(NODE, ports)
    assert listens == []
    assert json.loads(found.get_json("connect/endpoints")) == connects
