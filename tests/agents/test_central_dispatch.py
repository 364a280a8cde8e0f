"""A dispatch that makes no sense is refused or clamped, counted and told."""

from __future__ import annotations

import math

import pytest
from plants_by_hand import CYCLE_NS, at, plan_of, report, tell

from agents.sequencer import Sequencer
from agents.team import Controller, central_controller
from bus_schemas.messages import Dispatch, Message, Notice, Request
from bus_schemas.signals import DISPATCH, HELP, NOTICE, REQUEST, SETPOINT, Port
from bus_schemas.tree import ROOT

PLAN = plan_of({"a": 100.0, "b": 300.0})


def asked_and_noticed(*dispatches_kw: float) -> tuple[list[float], list[tuple[str, int]]]:
    """What is asked of `b`, which has 3/4 of the rating, and what is noticed, for each dispatch."""
    agent = central_controller(PLAN)
    asked_kw: list[float] = []
    noticed: list[tuple[str, int]] = []
    central = Sequencer(agent, PLAN.sim_time_ns, lockstep=False, horizon=1)
    for cycle, power_kw in enumerate(dispatches_kw):
        if cycle == 0:
            central.enter(0)
        said: dict[Port[Message], Message] = dict(
            central.accept(
                DISPATCH.of(ROOT),
                Dispatch(
                    cycle,
                    cycle * CYCLE_NS,
                    "plant",
                    (),
                    power_kw=power_kw,
                    commitment_kw=power_kw,
                    regulation_kw=0.0,
                ),
            )
        )
        request = said[REQUEST.of("b")]
        assert isinstance(request, Request)
        asked_kw.append(request.power_kw)
        notice = said.get(NOTICE.of(ROOT))
        if isinstance(notice, Notice):
            noticed.append((notice.text, notice.count))
        central.close_stage()
    return asked_kw, noticed


@pytest.mark.parametrize("power_kw", [0.0, 200.0, 400.0])
def test_a_dispatch_from_zero_to_the_rating_is_taken_without_a_word(power_kw: float) -> None:
    assert asked_and_noticed(power_kw) == ([0.75 * power_kw], [])


@pytest.mark.parametrize(
    ("power_kw", "shown"),
    [(math.nan, "nan"), (math.inf, "inf"), (-math.inf, "-inf")],
)
def test_a_dispatch_that_makes_no_sense_is_refused_and_the_last_one_holds(
    power_kw: float, shown: str
) -> None:
    assert asked_and_noticed(200.0, power_kw) == (
        [150.0, 150.0],
        [(f"dispatch of {shown} kW refused, accepted is 0 to 400 kW: 200 kW still holds", 1)],
    )


def test_before_the_first_good_dispatch_nothing_is_asked() -> None:
    text = (
        "dispatch of nan kW refused, accepted is 0 to 400 kW: there was none before it, nothing is "
        "held back"
    )
    assert asked_and_noticed(math.nan) == ([0.0], [(text, 1)])


def test_a_dispatch_of_zero_is_one() -> None:
    asked_kw, noticed = asked_and_noticed(0.0, math.nan)
    assert asked_kw == [0.0, 0.0]
    assert noticed[0][0].endswith(": 0 kW still holds")


def in_cycle_0_without_dispatch() -> Sequencer[object]:
    agent: Controller = central_controller(PLAN)
    central: Sequencer[object] = Sequencer(agent, PLAN.sim_time_ns, lockstep=False, horizon=1)
    central.enter(0)
    asked = dict(central.close_stage())
    assert at(asked, REQUEST.of("a")).power_kw == 0.0
    assert at(asked, REQUEST.of("b")).power_kw == 0.0
    return central


def test_before_the_first_dispatch_nothing_is_held_back() -> None:
    central = in_cycle_0_without_dispatch()
    said = tell(central, *report("a", 0, 80.0, 80.0), *report("b", 0, 90.0, 90.0))
    assert [at(said, SETPOINT.of(child)).power_kw for child in ("a", "b")] == [80.0, 90.0]
    assert HELP.of(ROOT) not in said


def test_before_the_first_dispatch_and_the_first_report_nothing_is_held_back() -> None:
    said = dict(in_cycle_0_without_dispatch().close_stage())
    assert [at(said, SETPOINT.of(child)).power_kw for child in ("a", "b")] == [100.0, 300.0]
    assert HELP.of(ROOT) not in said


@pytest.mark.parametrize(
    ("power_kw", "shown"), [(400.0001, "400.0001"), (500.0, "500"), (1e12, "1e+12")]
)
def test_a_dispatch_above_the_rating_is_clamped_to_it(power_kw: float, shown: str) -> None:
    assert asked_and_noticed(power_kw) == (
        [300.0],
        [(f"dispatch of {shown} kW clamped to the rating, 400 kW", 1)],
    )


@pytest.mark.parametrize(("power_kw", "shown"), [(-0.5, "-0.5"), (-1e12, "-1e+12")])
def test_a_dispatch_below_zero_is_clamped_to_it(power_kw: float, shown: str) -> None:
    # Regulation downwards can ask for more than the commitment: the plant goes as low as it can.
    assert asked_and_noticed(200.0, power_kw) == (
        [150.0, 0.0],
        [(f"dispatch of {shown} kW clamped to 0 kW", 1)],
    )


def test_all_that_could_not_be_used_are_counted_together() -> None:
    asked_kw, noticed = asked_and_noticed(100.0, -1.0, 500.0, 200.0, math.nan)
    assert asked_kw == [75.0, 0.0, 300.0, 150.0, 150.0]
    assert [count for _, count in noticed] == [1, 2, 3]


def test_after_a_clamped_dispatch_a_refused_one_leaves_the_rating_asked() -> None:
    asked_kw, noticed = asked_and_noticed(1e12, math.nan)
    assert asked_kw == [300.0, 300.0]
    assert noticed[1][0] == (
        "dispatch of nan kW refused, accepted is 0 to 400 kW: 400 kW still holds"
    )
