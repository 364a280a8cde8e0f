"""An independent reader of COMTRADE finds in an export what the recording holds."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from math import isnan
from pathlib import Path
from typing import Any

import comtrade
import pytest
from command_line import heliarch, refusal
from msgspec.structs import replace
from recordings_by_hand import PLAN, whole_run, write_run

from bus_schemas.bus import Delivery
from bus_schemas.messages import Dispatch, Message, Production
from bus_schemas.signals import PRODUCTION
from bus_schemas.tree import ROOT
from heliarch import simulate
from recordings.read.reader import RunReader
from recordings.read.run_clock import RunClock

ORDER = 50


def said() -> Iterator[Delivery]:
    """A run in which an order of 150 kW comes in cycle 50, and `c2` is gone in 52 to 55."""
    for port, message in whole_run(100):
        if port.node != "c2" or not 52 <= message.cycle < 56:
            yield port, changed(message)


def changed(message: Message) -> Message:
    if isinstance(message, Dispatch) and message.cycle >= ORDER:
        order: dict[str, Any] = {"order_source": "command", "order_state": "holds"}
        return replace(message, power_kw=150.0, order_power_kw=150.0, order_cycle=ORDER, **order)
    if isinstance(message, Production):
        c1_kw = 40.0 + 0.1 * message.cycle, 80.0
        return replace(message, inverter_power_kw=(*c1_kw, 60.0, 59.0))
    return message


@pytest.fixture
def run(tmp_path: Path) -> Path:
    write_run(tmp_path / "run.mcap", said())
    return tmp_path


def exported(run: Path, *words: str) -> comtrade.Comtrade:
    result = heliarch("export", run, "--format", "comtrade", *words)
    assert result.exit_code == 0, result.output
    return comtrade.load(str(run / "run-comtrade" / "run.cfg"))


def channel(record: comtrade.Comtrade, name: str) -> list[float]:
    analog, digital = record.analog_channel_ids, record.status_channel_ids
    found = record.analog[analog.index(name)] if name in analog else None
    return list(record.status[digital.index(name)] if found is None else found)


def test_an_independent_reader_finds_time_trigger_powers_order_and_outage(run: Path) -> None:
    record = exported(run, "--at", f"c{ORDER}", "--window", f"{10 * PLAN.timing.cycle_s}")
    local = RunClock(PLAN, 99).local

    def stamp(cycle: int) -> datetime:
        return local(cycle).replace(tzinfo=None)

    assert (record.station_name, record.rec_dev_id) == (PLAN.plant, PLAN.run_id)
    assert (record.start_timestamp, record.trigger_timestamp) == (stamp(40), stamp(50))
    seconds = [number * PLAN.timing.cycle_s for number in range(21)]
    assert list(record.time) == pytest.approx(seconds)
    cycles = range(40, 61)
    assert channel(record, "c1 power") == pytest.approx([120 + 0.1 * k for k in cycles], abs=1e-4)
    assert channel(record, "delivered") == pytest.approx([239 + 0.1 * k for k in cycles], abs=1e-4)
    assert channel(record, "c2 power") == pytest.approx([119.0] * 21)
    ordered = [k >= ORDER for k in cycles]
    assert channel(record, "dispatch") == pytest.approx(
        [150.0 if one else 240.0 for one in ordered], abs=1e-3
    )
    assert channel(record, "order in force") == ordered
    assert channel(record, "c2 absent") == [52 <= k < 56 for k in cycles]
    assert not any(channel(record, "frequency response"))


def test_cycles_that_the_plant_did_not_complete_are_unknown(tmp_path: Path) -> None:
    kept = (
        (port, message)
        for port, message in said()
        if port is not PRODUCTION.of(ROOT) or message.cycle < 95
    )
    write_run(tmp_path / "run.mcap", kept)
    record = exported(tmp_path, "--at", "c90")
    delivered = channel(record, "delivered")
    with RunReader(tmp_path / "run.mcap") as reader:
        assert len(delivered) == reader.last_cycle - 90 + 61
    assert [*map(isnan, delivered[-6:])] == [False, *[True] * 5]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--format", "comtrade"), "--at"),
        (("--format", "csv", "--at", "c3"), "--format comtrade"),
        (("--format", "csv", "--window", "9"), "--format comtrade"),
        (("--format", "comtrade", "--at", "c3", "--nodes", "c1"), "--window"),
        (("--format", "comtrade", "--at", "c2000"), "--at: expected a time of the run"),
    ],
)
def test_what_does_not_go_together_is_refused(
    run: Path, words: tuple[str, ...], named: str
) -> None:
    assert named in refusal("export", run, *words)
    assert not (run / "run-comtrade").exists()


def test_meters_of_a_fleet_and_its_storages_have_channels(tmp_path: Path) -> None:
    run = simulate("fleet", duration=10, out=tmp_path / "run")
    record = exported(tmp_path / "run", "--at", "5", "--window", "10")
    plants = sum(channel(record, f"{name} delivered")[-1] for name in ("west", "north", "east"))
    delivered = channel(record, "delivered")
    assert plants == pytest.approx(delivered[-1], rel=1e-4)
    stored = run.frame("production")["storage_energy_kwh"]
    assert channel(record, "east/battery stored")[0] == pytest.approx(stored.iloc[0][0], rel=1e-4)
