"""A fleet of plants as real processes: equal to one process, and exact after kills."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from running import Start, small_plant
from test_launch import decided, decisions, summary_of
from test_restarts import ended, until_joined

from agents.plan_file import load_plan
from recordings.verify.verification import verify

pytestmark = pytest.mark.processes

FLEET = """\
name = "pair"
title = "Two plants"

[time]
start = 2010-04-01T12:00:00
timezone = "Pacific/Honolulu"
duration_s = 7200
cycle_s = 1

[commitment]
kind = "share-of-clear-sky"
share = 0.9

[grid]
ramp_up_kw_per_min = 6000

[control]
storage = "first"

[[plants]]
name = "west"
scenario = "small.toml"
export_limit_kw = 300

[[plants]]
name = "east"
scenario = "small.toml"
lat = 21.5
lon = -157.7

[plants.set]
"grid.loss_quadratic_percent" = 2.0
"grid.ramp_up_kw_per_min" = 4000.0

[[storage]]
name = "battery"
cluster = "east"
rating_kw = 100
capacity_kwh = 2
"""


@pytest.fixture
def fleet(tmp_path: Path) -> str:
    small_plant(tmp_path, ('history = "hindsight"', 'history = "earlier-day"'))
    (tmp_path / "pair.toml").write_text(FLEET, encoding="utf-8")
    return str(tmp_path / "pair.toml")


@pytest.mark.parametrize("processes", ["agent", '["west","east"]'])
def test_a_launched_fleet_decides_bit_for_bit_what_one_process_decides(
    fleet: str, tmp_path: Path, processes: str
) -> None:
    words = (fleet, "--duration", "40", "--set", f"processes={processes}")
    launched = decided(tmp_path / "launched", "launch", *words)
    assert launched == decided(tmp_path / "simulated", "simulate", *words)
    ports = {port for port, _ in launched}
    assert {"meter", "west/meter", "east/meter", "west/memory", "east/battery/command"} <= ports
    plan = load_plan(tmp_path / "launched" / "plan.json")
    assert len(plan.wiring.members) == (5 if processes != "agent" else len(plan.agents))
    assert [one.name for one in summary_of(tmp_path / "launched").plants] == ["west", "east"]


def test_a_fleet_goes_on_and_is_verified_exactly_after_kills(heliarch: Start, fleet: str) -> None:
    run = heliarch("launch", fleet, "--duration", "2h", "--set", "restart.when=on-failure")
    run.until_recorded()
    for victim in ("west", "central", "east/battery"):
        run.process_of(victim).send_signal(signal.SIGKILL)
        until_joined(run, victim)
        run.until_recorded(run.recorded_cycles() + 5)
    ended(run)
    assert decisions(run.folder)
    assert summary_of(run.folder).restarts == {"west": 1, "central": 1, "east/battery": 1}
    found = verify(run.folder)
    assert found.equal
    assert not found.left_out
