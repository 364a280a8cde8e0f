"""What controllers do while inputs do not come: the fallback ladder."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import AtWork, at, dispatch, impp, report, setpoint, telemetry

from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Message, Setpoint
from bus_schemas.signals import COMMAND, HELP, IMPP, RESIDUAL, Port
from bus_schemas.tree import ROOT

HOLD = 2
TWO = plan_of({"a": 100.0, "b": 100.0}, cycles=100, hold_cycles=HOLD, cycle_wall_ns=REAL_TIME)
"""Two inverters below the central controller, by the clock."""

CLUSTER = plan_of(
    {"c1/a": 100.0, "c1/b": 100.0}, cycles=100, hold_cycles=HOLD, cycle_wall_ns=REAL_TIME
)
"""Two inverters below one supervisor."""

Sent = Mapping[Port[Message], Message]


def setpoints_kw(sent: Sent) -> tuple[float, ...]:
    return tuple(message.power_kw for message in sent.values() if isinstance(message, Setpoint))


# A controller without its parent ------------------------------------------------------------------


def outputs_in(
    work: AtWork, cycle: int, *, setpoint_kw: float | None = None, dispatch_kw: float | None = 100.0
) -> tuple[float, ...]:
    """Let a cycle go by; return the alpha of c1/a, or the setpoints of c1.

    c1/a measures 80 kW. To c1, its children report 20 and 90 kW.
    """
    name = work.loop.name
    if name == "c1":
        work.hear(*report("c1/a", cycle, 20.0, 0.0), *report("c1/b", cycle, 90.0, 0.0))
    else:
        work.hear(telemetry(name, cycle, 80.0))
    if dispatch_kw is None:
        work.at_deadline(work.loop.stage)
    else:
        work.hear(dispatch(cycle, dispatch_kw, 200.0))
    if setpoint_kw is None:
        sent = work.at_deadline(work.loop.stage)
    else:
        sent = work.hear(setpoint(name, cycle, setpoint_kw))
    command = COMMAND.of(name)
    return (at(sent, command).alpha,) if command in sent else setpoints_kw(sent)


@pytest.mark.parametrize(
    ("name", "setpoint_kw", "by_setpoint", "by_dispatch", "by_50_kw"),
    [
        # Its share of 100 kW is 100 kW x 100 / 200 = 50 kW, which is 0.625 of 80 kW.
        ("c1/a", 20.0, (0.25,), (0.625,), (0.3125,)),
        # All of the dispatch is the cluster's.
        ("c1", 60.0, (20.0, 40.0), (20.0, 80.0), (20.0, 30.0)),
    ],
)
def test_a_controller_goes_down_the_ladder_and_up_again(
    name: str,
    setpoint_kw: float,
    by_setpoint: tuple[float, ...],
    by_dispatch: tuple[float, ...],
    by_50_kw: tuple[float, ...],
) -> None:
    work = AtWork(CLUSTER, name)
    assert outputs_in(work, 0, setpoint_kw=setpoint_kw) == by_setpoint
    # The newest setpoint holds,
    assert [outputs_in(work, cycle) for cycle in (1, 2)] == [by_setpoint] * HOLD
    # then the controller's own share of the dispatch,
    assert [outputs_in(work, cycle) for cycle in (3, 4)] == [by_dispatch] * 2
    assert outputs_in(work, 5, dispatch_kw=50.0) == by_50_kw
    # and where the dispatch has expired too, nothing is sent.
    after_hold = [outputs_in(work, cycle, dispatch_kw=None) for cycle in (6, 7, 8, 9)]
    assert after_hold == [by_50_kw] * HOLD + [()] * 2
    assert outputs_in(work, 10) == by_dispatch
    assert outputs_in(work, 11, setpoint_kw=setpoint_kw) == by_setpoint


# A child that expired -----------------------------------------------------------------------------


def central_after_one_cycle() -> AtWork:
    """120 kW dispatched; a could give 80 kW, b 90 kW."""
    central = AtWork(TWO, "central")
    sent = cycle_of(central, 0, *report("a", 0, 80.0, 20.0), *report("b", 0, 90.0, 30.0))
    assert setpoints_kw(sent) == (60.0, 60.0)
    return central


def cycle_of(central: AtWork, cycle: int, *reports: Delivery, dispatch_kw: float = 120.0) -> Sent:
    """Let a cycle go by with what children report; the plant's meter is silent."""
    sent = central.hear(dispatch(cycle, dispatch_kw, 200.0), *reports)
    return sent | central.at_deadline("solve")


def test_without_its_residual_a_report_counts_and_the_residual_is_worked_out() -> None:
    central = central_after_one_cycle()
    for cycle in (1, 2, 3, 4):
        reports = (*report("a", cycle, 80.0, 0.0), impp("b", cycle, 50.0))
        sent = cycle_of(central, cycle, *reports, dispatch_kw=160.0)
        assert at(sent, IMPP.of(ROOT)).power_kw == 130.0
        assert at(sent, RESIDUAL.of(ROOT)).power_kw == 0.0 + (50.0 - 80.0)
        assert setpoints_kw(sent) == (80.0, 50.0)


# An inverter unheard ------------------------------------------------------------------------------


Blind = list[tuple[float, int, tuple[float, float] | None]]
"""For each cycle: the IMPP and its age, then alpha and power of the command."""


@pytest.mark.parametrize(
    ("power_kw", "hears_dispatch", "expected"),
    [
        # Its last maximum holds for a while. Then it is not counted on, and given its own share.
        *(
            (kw, True, [*((80.0, n, (0.25, 20.0)) for n in (1, 2)), (0.0, 3, (0.625, 50.0))])
            for kw in (None, math.nan, 80_000.0)
        ),
        # Where the whole plant is not heard, nothing says that this inverter is lost.
        (
            None,
            False,
            [*((80.0, n, (0.25, 20.0)) for n in (1, 2)), (80.0, 3, (0.25, 20.0))],
        ),
    ],
)
def test_an_inverter_without_usable_telemetry_is_counted_on_for_the_hold_alone(
    power_kw: float | None, hears_dispatch: bool, expected: Blind
) -> None:
    work = AtWork(CLUSTER, "c1/a")
    outputs_in(work, 0, setpoint_kw=20.0)
    found: Blind = []
    for cycle in range(1, HOLD + 2):
        heard = [] if power_kw is None else [telemetry("c1/a", cycle, power_kw)]
        sent = work.hear(*heard, *([dispatch(cycle, 100.0, 200.0)] if hears_dispatch else []))
        own = at(sent or work.at_deadline("estimate"), IMPP.of("c1/a"))
        # Its parent no longer counts on it either.
        sent = work.hear(setpoint("c1/a", cycle, 20.0 if own.power_kw else 0.0))
        command = sent.get(COMMAND.of("c1/a"))
        assert command is None or isinstance(command, Command)
        levels = None if command is None else (command.alpha, command.power_kw)
        found.append((own.power_kw, own.stale_cycles, levels))
    assert found == expected
    assert outputs_in(work, HOLD + 2, setpoint_kw=20.0) == (0.25,)


def test_a_silent_child_is_not_set_to_0_kw_because_no_dispatch_is_heard() -> None:
    """c1 hears its setpoint, and c1/a; but neither a dispatch nor, ever, c1/b."""
    work = AtWork(CLUSTER, "c1")
    work.hear(*report("c1/a", 0, 90.0, 0.0))
    work.at_deadline("report")
    assert setpoints_kw(work.hear(setpoint("c1", 0, 60.0))) == (30.0, 30.0)


def test_before_the_first_telemetry_there_is_no_power_to_count_on() -> None:
    work = AtWork(CLUSTER, "c1/a")
    work.hear(dispatch(0, 100.0, 200.0))
    sent = work.at_deadline("estimate")
    found = at(sent, IMPP.of("c1/a"))
    assert (found.power_kw, found.missing) == (0.0, ("c1/a/telemetry",))
    assert at(sent, HELP.of("c1/a")).missing_kw == 50.0
    # A command would free an inverter that may be limited.
    assert COMMAND.of("c1/a") not in work.hear(setpoint("c1/a", 0, 20.0))
    assert outputs_in(work, 1, setpoint_kw=20.0) == (0.25,)
