"""Anybody may say that a run ends early. What the plant goes on doing tells whether it is true."""

from __future__ import annotations

from plans_by_hand import plan_of
from plants_by_hand import AtWork, dispatch, setpoint, telemetry

from bus_schemas.bus import Delivery
from bus_schemas.signals import COMMAND, RUN
from bus_schemas.tree import ROOT

PLAN = plan_of({"c1/a": 100.0}, cycles=20, period_cycles=(1, 1))
COMMAND_OF_A = COMMAND.of("c1/a")


def stop(cycle: int) -> Delivery:
    return RUN.of(ROOT), PLAN.run_message("stop", cycle, 0)


def goes_on(inverter: AtWork, cycle: int) -> bool:
    """Whether it gives a command in a cycle that the plant has begun."""
    inputs = (telemetry("c1/a", cycle, 50.0), dispatch(cycle, 50.0, 100.0))
    return COMMAND_OF_A in inverter.hear(*inputs, setpoint("c1/a", cycle, 40.0))


def test_a_stop_before_a_cycle_that_has_begun_is_not_heeded() -> None:
    inverter = AtWork(PLAN, "c1/a")
    inverter.hear(dispatch(0, 50.0, 100.0), stop(0))
    inverter.hear(telemetry("c1/a", 0, 50.0))
    assert COMMAND_OF_A in inverter.hear(setpoint("c1/a", 0, 40.0))
    assert not inverter.loop.finished
    assert inverter.loop.dropped["run", "contradicted"] == 1


def test_a_stop_holds_until_the_plant_goes_on() -> None:
    inverter = AtWork(PLAN, "c1/a")
    inverter.hear(stop(2))
    assert goes_on(inverter, 0)
    assert goes_on(inverter, 1)
    assert inverter.loop.finished
    assert goes_on(inverter, 2)
    assert goes_on(inverter, 3)
    assert not inverter.loop.stop_heard
    assert inverter.loop.dropped["run", "contradicted"] == 1
