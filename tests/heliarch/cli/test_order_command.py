"""`heliarch order`, to a plant that does what it is ordered."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import done, heliarch, refusal
from order_desks import SCHEDULED_KW, obeying_plant
from plans_by_hand import plan_of

PLAN = plan_of({"a": 200.0, "b": 200.0}, cycles=10_000)


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Path]:
    with obeying_plant(tmp_path, PLAN, able_kw=300.0):
        yield tmp_path


def test_an_order_prints_when_and_how_well_the_plant_got_there(run: Path) -> None:
    reply, settled = done("order", run, "250kW").splitlines()
    assert reply.startswith("in force from cycle ")
    assert settled == "250 kW reached within 1 % after 1.0 s, overshoot 0.0 %"
    # 4 kW are 1 % of the rating: of 249, 248, ... the 46th step is the first one as near.
    found = done("order", run / "run.mcap", "0.2MW", "--ramp", "60kW/min")
    assert found.splitlines()[1].startswith(
        "200 kW reached within 1 % after 46.0 s, 45.0 s of them a ramp"
    )
    found = done("order", run, "schedule")
    assert found.splitlines()[1].startswith(f"{SCHEDULED_KW:.0f} kW reached within 1 % after 1.0 s")


def test_an_order_that_the_sun_does_not_allow_is_a_failure_that_says_so(run: Path) -> None:
    result = heliarch("order", run, "0.35MW", "--json", "-")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["settling_s"] is None
    assert "350 kW not reached within 1 %; the sun gave less" in result.stderr


def test_a_run_that_is_over_or_is_none_is_refused_in_one_line(run: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    assert str(other) in refusal("order", other, "2kW")
    # Of a fleet somebody may mean a plant: the order must not reach them all.
    assert str(run / "west") in refusal("order", run / "west", "2kW")
    with obeying_plant(other, PLAN):
        pass
    assert "under way" in refusal("order", other, "2kW")


@pytest.mark.parametrize("power", ["-3kW", "nan", "401kW", "2MWh", "2000", "2 MW", "inf", "NaNkW"])
def test_a_power_that_cannot_be_is_refused_in_one_line(run: Path, power: str) -> None:
    assert "400 kW" in refusal("order", run, power)


def test_the_schedule_has_no_end_after_which_the_schedule_returns(run: Path) -> None:
    assert "--hold: expected a power" in refusal("order", run, "schedule", "--hold", "5s")
