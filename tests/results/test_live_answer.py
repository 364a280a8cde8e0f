"""The answer to an order while it comes: what the grid asks beside it, what stands against it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from plans_by_hand import plan_of

from agents.settings import Droop, GridSettings
from bus_schemas.errors import FailureError
from bus_schemas.messages import Dispatch
from bus_schemas.tree import PLANT
from results.live_answer import LiveAnswer
from sim_plant.order_desk import FromPlant, PlantStatus, Reply

FROM_KW, TO_KW = 100.0, 200.0


def dispatch_of(cycle: int) -> Dispatch:
    """The dispatch of a cycle: an order of 200 kW comes into force in cycle 1."""
    order: dict[str, Any] = {"power_kw": FROM_KW}
    if cycle:
        order = {"power_kw": TO_KW, "order_power_kw": TO_KW, "order_state": "holds"}
        order |= {"order_source": "command", "order_cycle": 1}
    schedule: dict[str, Any] = {
        "plant_rating_kw": 400.0,
        "commitment_kw": FROM_KW,
        "regulation_kw": 0.0,
    }
    return Dispatch(cycle, 0, PLANT, (), **schedule, **order)


def text_of(grid: GridSettings, delivered_kw: Iterator[float], **status: Any) -> str:
    """What is said of an order of 200 kW to a plant of 400 kW that delivered this, by second."""
    plan = plan_of({"a": 200.0, "b": 200.0}, cycles=10_000, grid=grid)

    def heard() -> Iterator[FromPlant]:
        for cycle, kw in enumerate((FROM_KW, *delivered_kw)):
            if cycle == 1:
                yield Reply(text="in force from cycle 1", is_in_force=True)
            yield PlantStatus(
                dispatch=dispatch_of(cycle),
                available_kw=400.0,
                delivered_kw=kw,
                **status,
            )

    reply, *meanwhile, found = [text for text in LiveAnswer(plan).lines(heard()) if text]
    assert (reply, meanwhile) == ("in force from cycle 1", [])
    return found


def test_the_plants_own_ramp_limit_makes_a_ramp_of_a_step() -> None:
    grid = GridSettings(ramp_up_kw_per_min=60.0)
    along = [min(FROM_KW + second, TO_KW) for second in range(1, 120)]
    found = text_of(grid, iter(along))  # 4 kW are 1 % of the rating: 196 kW in the 96th second.
    assert found == "200 kW reached within 1 % after 96.0 s, 95.0 s of them a ramp, overshoot 0.0 %"
    early = text_of(grid, iter(along[:50]))
    assert "not reached" in early
    assert "the grid's ramp limit is 60 kW/min; the run is over" in early


def test_a_response_to_the_frequency_is_no_error_and_its_lack_is_named() -> None:
    # 5 % beyond 36 mHz, upwards out of 40 kW: 0.136 Hz below 60 Hz ask for 13.3 kW.
    grid = GridSettings(droop=Droop(reserve_percent=10.0))
    answered = text_of(grid, iter([TO_KW + 40.0 / 3.0] * 20), frequency_hz=59.864)
    assert "200 kW reached within 1 % after 1.0 s" in answered
    silent = text_of(grid, iter([TO_KW] * 80), frequency_hz=59.864)
    assert silent == "200 kW not reached within 1 %; the frequency is 59.864 Hz"


def test_an_order_that_did_not_come_into_force_ends_with_the_reply() -> None:
    found = LiveAnswer(plan_of({"a": 400.0}, cycles=10))
    replied: list[FromPlant] = [Reply(text="replaced by the page in cycle 3")]
    assert list(found.lines(replied)) == ["replaced by the page in cycle 3"]
    assert found.is_over
    assert found.answer is None


def test_a_run_that_ends_before_it_takes_the_order_is_a_failure() -> None:
    with pytest.raises(FailureError, match="run ended"):
        list(LiveAnswer(plan_of({"a": 400.0}, cycles=10)).lines([]))
