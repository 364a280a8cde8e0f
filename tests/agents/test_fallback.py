"""What controllers do while inputs do not come: the fallback ladder."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import AtWork, at, dispatch, impp, report, setpoint, telemetry

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message, Setpoint
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


# A direct controller without its parent -----------------------------------------------------------


def direct() -> AtWork:
    """An inverter of 100 kW that could give 80 kW."""
    return AtWork(CLUSTER, "c1/a")


def alpha_in(
    work: AtWork, cycle: int, *, setpoint_kw: float | None = None, dispatch_kw: float | None = 100.0
) -> float | None:
    """Let a cycle go by, and return the alpha that is commanded, if any."""
    work.hear(telemetry("c1/a", cycle, 80.0))
    if dispatch_kw is None:
        work.at_deadline("estimate")
    else:
        work.hear(dispatch(cycle, dispatch_kw, 200.0))
    if setpoint_kw is None:
        sent = work.at_deadline("actuate")
    else:
        sent = work.hear(setpoint("c1/a", cycle, setpoint_kw))
    command = COMMAND.of("c1/a")
    return at(sent, command).alpha if command in sent else None


def test_a_direct_controller_goes_down_the_ladder_and_up_again() -> None:
    work = direct()
    assert alpha_in(work, 0, setpoint_kw=20.0) == 0.25
    # The newest setpoint holds,
    assert [alpha_in(work, cycle) for cycle in (1, 2)] == [0.25] * HOLD
    # then the inverter's own share of the dispatch: 100 of 200 kW x 100 kW,
    assert [alpha_in(work, cycle) for cycle in (3, 4)] == [0.625] * 2
    assert alpha_in(work, 5, dispatch_kw=60.0) == 0.375
    # and where the dispatch is silent too, nothing is sent.
    silent = [alpha_in(work, cycle, dispatch_kw=None) for cycle in (6, 7, 8, 9)]
    assert silent == [0.375] * HOLD + [None] * 2
    assert alpha_in(work, 10) == 0.625
    assert alpha_in(work, 11, setpoint_kw=20.0) == 0.25


@pytest.mark.parametrize("most_kw", [100.0, 100.0 * (1.0 + 1e-12)])
def test_a_setpoint_may_exceed_the_rating_by_a_rounding_error(most_kw: float) -> None:
    assert alpha_in(direct(), 0, setpoint_kw=most_kw) == 1.0


# A supervisor without its parent ------------------------------------------------------------------


def setpoints_in(
    work: AtWork, cycle: int, *, setpoint_kw: float | None = None, dispatch_kw: float | None = 100.0
) -> tuple[float, ...]:
    """Let a cycle go by in which c1/a could give 20 and c1/b 90 kW; return their setpoints."""
    work.hear(*report("c1/a", cycle, 20.0, 0.0), *report("c1/b", cycle, 90.0, 0.0))
    if dispatch_kw is None:
        work.at_deadline("report")
    else:
        work.hear(dispatch(cycle, dispatch_kw, 200.0))
    if setpoint_kw is None:
        return setpoints_kw(work.at_deadline("solve"))
    return setpoints_kw(work.hear(setpoint("c1", cycle, setpoint_kw)))


def test_a_supervisor_goes_down_the_same_ladder() -> None:
    work = AtWork(CLUSTER, "c1")
    assert setpoints_in(work, 0, setpoint_kw=60.0) == (20.0, 40.0)
    assert [setpoints_in(work, cycle) for cycle in (1, 2)] == [(20.0, 40.0)] * HOLD
    assert setpoints_in(work, 3) == (20.0, 80.0), "all of the dispatch is the cluster's"
    assert setpoints_in(work, 4, dispatch_kw=50.0) == (20.0, 30.0)
    silent = [setpoints_in(work, cycle, dispatch_kw=None) for cycle in (5, 6, 7)]
    assert silent == [(20.0, 30.0)] * HOLD + [()]
    assert setpoints_in(work, 8, setpoint_kw=60.0) == (20.0, 40.0)


# A silent child -----------------------------------------------------------------------------------


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


Cycles = list[tuple[float, int, float, tuple[float, float]]]
"""For each cycle: the plant's IMPP, its age, its residual, and the setpoints of a and b."""


@pytest.mark.parametrize(
    ("of_b", "expected"),
    [
        # The last report of b holds, then its request counts, without headroom or need of help.
        # When b reports again, its reports count again.
        (
            [None, None, None, None, (90.0, 30.0), None],
            [
                *((170.0, age, 50.0, (60.0, 60.0)) for age in (1, 2)),
                *((140.0, 3, 20.0, (60.0, 60.0)) for _ in range(2)),
                *((170.0, age, 50.0, (60.0, 60.0)) for age in (0, 1)),
            ],
        ),
        # While its last report counts, b gives 20 kW and a the rest; then b serves its own request.
        (
            [(20.0, -40.0), None, None, None],
            [
                *((100.0, age, -20.0, (80.0, 20.0)) for age in (0, 1, 2)),
                (140.0, 3, 20.0, (60.0, 60.0)),
            ],
        ),
    ],
)
def test_the_last_report_of_a_silent_child_holds_and_then_its_own_request_counts(
    of_b: list[tuple[float, float] | None], expected: Cycles
) -> None:
    central, found = central_after_one_cycle(), []
    for cycle, said in enumerate(of_b, start=1):
        reports = report("a", cycle, 80.0, 20.0) + (report("b", cycle, *said) if said else [])
        sent = cycle_of(central, cycle, *reports)
        own, residual_kw = at(sent, IMPP.of(ROOT)), at(sent, RESIDUAL.of(ROOT)).power_kw
        found.append((own.power_kw, own.stale_cycles, residual_kw, setpoints_kw(sent)))
        assert (HELP.of(ROOT) in sent) == (residual_kw < 0.0)
    assert found == expected


def test_the_request_of_a_silent_child_is_by_its_rating() -> None:
    plan = plan_of({"a": 100.0, "b": 300.0}, cycle_wall_ns=REAL_TIME)
    central = AtWork(plan, "central")
    central.hear(dispatch(0, 200.0, 400.0), *report("a", 0, 80.0, 30.0))
    assert setpoints_kw(central.at_deadline("solve")) == (50.0, 150.0)


def test_without_its_residual_a_report_counts_and_the_residual_is_worked_out() -> None:
    central = central_after_one_cycle()
    for cycle in (1, 2, 3, 4):
        reports = (*report("a", cycle, 80.0, 0.0), impp("b", cycle, 50.0))
        sent = cycle_of(central, cycle, *reports, dispatch_kw=160.0)
        assert at(sent, IMPP.of(ROOT)).power_kw == 130.0
        assert at(sent, RESIDUAL.of(ROOT)).power_kw == 0.0 + (50.0 - 80.0)
        assert setpoints_kw(sent) == (80.0, 50.0)


# A silent inverter --------------------------------------------------------------------------------


def test_without_telemetry_the_last_impp_holds_and_its_age_is_counted() -> None:
    work = direct()
    alpha_in(work, 0, setpoint_kw=20.0)
    found = []
    for cycle in (1, 2, 3):
        work.hear(dispatch(cycle, 100.0, 200.0))
        found.append(at(work.at_deadline("estimate"), IMPP.of("c1/a")))
        work.hear(setpoint("c1/a", cycle, 20.0))
    assert [(sent.power_kw, sent.stale_cycles) for sent in found] == [(80.0, n) for n in (1, 2, 3)]


def test_before_the_first_telemetry_there_is_no_power_to_count_on() -> None:
    work = direct()
    work.hear(dispatch(0, 100.0, 200.0))
    sent = work.at_deadline("estimate")
    found = at(sent, IMPP.of("c1/a"))
    assert (found.power_kw, found.missing) == (0.0, ("c1/a/telemetry",))
    assert at(sent, HELP.of("c1/a")).missing_kw == 50.0
    # A command would free an inverter that may be limited.
    assert COMMAND.of("c1/a") not in work.hear(setpoint("c1/a", 0, 20.0))
    assert alpha_in(work, 1, setpoint_kw=20.0) == 0.25
