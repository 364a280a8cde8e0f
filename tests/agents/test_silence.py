"""What becomes of inputs that do not come, or that make no sense."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest
from plants_by_hand import CYCLE_NS, at, plan_of, report, tell

from agents.direct import DirectController
from agents.plan import RunPlan
from agents.sequencer import Sequencer
from agents.team import Controller, central_controller, direct_controller, supervisor
from bus_schemas.bus import Delivery
from bus_schemas.messages import (
    Dispatch,
    Help,
    HelpGiven,
    Impp,
    Message,
    Request,
    Setpoint,
    Telemetry,
)
from bus_schemas.signals import (
    COMMAND,
    DISPATCH,
    HELP,
    IMPP,
    REQUEST,
    RESIDUAL,
    SETPOINT,
    TELEMETRY,
    Port,
)
from bus_schemas.tree import CENTRAL, ROOT

TWO = plan_of({"a": 100.0, "b": 100.0}, hold_cycles=2)
"""Two inverters below the central controller."""

CLUSTER = plan_of({"c1/a": 100.0, "c1/b": 100.0})
"""Two inverters below one supervisor."""

Said = Mapping[Port[Message], Message]


def in_real_time(agent: Controller, plan: RunPlan) -> Sequencer[object]:
    sequencer: Sequencer[object] = Sequencer(agent, plan.sim_time_ns, lockstep=False, horizon=1)
    sequencer.enter(0)
    return sequencer


def dispatch(cycle: int, power_kw: float) -> Delivery:
    message = Dispatch(
        cycle,
        cycle * CYCLE_NS,
        "plant",
        (),
        power_kw=power_kw,
        commitment_kw=power_kw,
        regulation_kw=0.0,
    )
    return DISPATCH.of(ROOT), message


def request(node: str, cycle: int, power_kw: float) -> Delivery:
    parent = node.rpartition("/")[0] or CENTRAL
    return REQUEST.of(node), Request(cycle, cycle * CYCLE_NS, parent, (), power_kw=power_kw)


def setpoint(node: str, cycle: int, power_kw: float) -> Delivery:
    parent = node.rpartition("/")[0] or CENTRAL
    message = Setpoint(
        cycle, cycle * CYCLE_NS, parent, (), power_kw=power_kw, share_kw=power_kw, help_given=()
    )
    return SETPOINT.of(node), message


def telemetry(node: str, cycle: int, power_kw: float, alpha: float) -> Delivery:
    message = Telemetry(
        cycle, cycle * CYCLE_NS, "plant", (), power_kw=power_kw, alpha=alpha, limit_kw=100.0
    )
    return TELEMETRY.of(node), message


def setpoints_kw(said: Said) -> tuple[float, ...]:
    return tuple(message.power_kw for message in said.values() if isinstance(message, Setpoint))


# A silent child -----------------------------------------------------------------------------------


def central_after_one_cycle() -> Sequencer[object]:
    """120 kW dispatched; a could give 80 kW, b 90 kW."""
    central = in_real_time(central_controller(TWO), TWO)
    said = tell(
        central, dispatch(0, 120.0), *report("a", 0, 80.0, 20.0), *report("b", 0, 90.0, 30.0)
    )
    assert setpoints_kw(said) == (60.0, 60.0)
    return central


def cycle_without_b(central: Sequencer[object], cycle: int) -> Said:
    tell(central, dispatch(cycle, 120.0), *report("a", cycle, 80.0, 20.0))
    return dict(central.close_stage())


def test_the_last_report_of_a_silent_child_holds_for_so_many_cycles_and_then_is_zero() -> None:
    central = central_after_one_cycle()
    told = [cycle_without_b(central, cycle) for cycle in (1, 2, 3, 4)]
    impps_kw = [at(said, IMPP.of(ROOT)).power_kw for said in told]
    # hold_cycles is 2: 80 + 90 kW in cycles 1 and 2, then 80 kW alone.
    assert impps_kw == [170.0, 170.0, 80.0, 80.0]


def test_the_share_of_a_child_that_stays_silent_is_given_to_the_others() -> None:
    central = central_after_one_cycle()
    told = [cycle_without_b(central, cycle) for cycle in (1, 2, 3)]
    # Of 120 kW, a can give 80. Should b be there and only be unheard, it is free to give the rest.
    assert [setpoints_kw(said) for said in told] == [(60.0, 60.0), (60.0, 60.0), (80.0, 40.0)]
    assert at(told[2], SETPOINT.of("a")).help_given == (HelpGiven("b", 20.0),)


def test_the_share_of_a_child_that_counts_as_zero_is_missing_in_the_residual() -> None:
    central = central_after_one_cycle()
    told = [cycle_without_b(central, cycle) for cycle in (1, 2, 3)]
    # Of 120 kW, 60 are b's share: a's 80 - 60 kW and b's 30 kW, later b's 0 - 60 kW.
    assert [at(said, RESIDUAL.of(ROOT)).power_kw for said in told] == [50.0, 50.0, -40.0]
    assert [HELP.of(ROOT) in said for said in told] == [False, False, True]
    assert at(told[2], HELP.of(ROOT)).missing_kw == 40.0


def test_the_share_that_is_missing_is_that_of_the_childs_rating() -> None:
    plan = plan_of({"a": 100.0, "b": 300.0})
    central = in_real_time(central_controller(plan), plan)
    tell(central, dispatch(0, 200.0), *report("a", 0, 80.0, 30.0))
    said = dict(central.close_stage())
    # b never spoke: of 200 kW it was asked for 150.
    assert at(said, IMPP.of(ROOT)).power_kw == 80.0
    assert at(said, RESIDUAL.of(ROOT)).power_kw == -120.0


def test_a_supervisor_lacks_the_share_of_a_silent_inverter() -> None:
    boss = in_real_time(supervisor(CLUSTER, "c1"), CLUSTER)
    tell(boss, request("c1", 0, 100.0), *report("c1/a", 0, 90.0, 40.0))
    said = dict(boss.close_stage())
    # a could give 40 kW more than it is asked for, b lacks its 50 kW.
    assert at(said, IMPP.of("c1")).power_kw == 90.0
    assert at(said, RESIDUAL.of("c1")).power_kw == -10.0
    assert at(said, HELP.of("c1")).missing_kw == 10.0


def test_a_silent_child_is_named_in_what_is_decided_without_it() -> None:
    said = cycle_without_b(central_after_one_cycle(), 1)
    assert {message.missing for message in said.values()} == {("b/impp", "b/residual")}


def test_a_child_that_speaks_again_is_taken_back() -> None:
    central = central_after_one_cycle()
    for cycle in (1, 2, 3):
        cycle_without_b(central, cycle)
    said = tell(
        central, dispatch(4, 120.0), *report("a", 4, 80.0, 20.0), *report("b", 4, 90.0, 30.0)
    )
    assert at(said, IMPP.of(ROOT)).power_kw == 170.0
    assert setpoints_kw(said) == (60.0, 60.0)
    # And its silence is counted from the beginning again.
    assert setpoints_kw(cycle_without_b(central, 5)) == (60.0, 60.0)


def test_without_its_residual_a_report_counts_and_the_residual_is_worked_out() -> None:
    central = central_after_one_cycle()
    told = []
    # hold_cycles is 2: a child that was taken for silent would count as zero in the end.
    for cycle in (1, 2, 3, 4):
        impp, _ = report("b", cycle, 50.0, -30.0)
        tell(central, dispatch(cycle, 160.0), *report("a", cycle, 80.0, 0.0), impp)
        told.append(dict(central.close_stage()))
    assert [at(said, IMPP.of(ROOT)).power_kw for said in told] == [130.0] * 4
    # Half of the 160 kW is asked of b.
    assert [at(said, RESIDUAL.of(ROOT)).power_kw for said in told] == [-30.0] * 4
    assert [setpoints_kw(said) for said in told] == [(80.0, 50.0)] * 4
    assert {said[IMPP.of(ROOT)].missing for said in told} == {("b/residual",)}


def test_between_turns_it_is_worked_out_from_the_request_of_the_last_turn() -> None:
    plan = plan_of({"a": 100.0, "b": 300.0}, period_cycles=(5,))
    central = in_real_time(central_controller(plan), plan)
    tell(central, dispatch(0, 200.0), *report("a", 0, 80.0, 30.0), *report("b", 0, 90.0, -60.0))
    central.close_stage()
    impp, _ = report("b", 1, 100.0, -50.0)
    tell(central, dispatch(1, 400.0), *report("a", 1, 80.0, 30.0), impp)
    said = dict(central.close_stage())
    # Of b 150 kW are asked, up to the next turn, whatever the operator has said since.
    assert at(said, RESIDUAL.of(ROOT)).power_kw == 30.0 + (100.0 - 150.0)


def test_a_residual_without_impp_is_silence() -> None:
    central = central_after_one_cycle()
    impps_kw = []
    for cycle in (1, 2, 3):
        _, residual = report("b", cycle, 50.0, 10.0)
        tell(central, dispatch(cycle, 120.0), *report("a", cycle, 80.0, 20.0), residual)
        impps_kw.append(at(dict(central.close_stage()), IMPP.of(ROOT)).power_kw)
    assert impps_kw == [170.0, 170.0, 80.0]


@pytest.mark.parametrize(
    ("impp_kw", "residual_kw"),
    [
        (math.nan, 0.0),
        (math.inf, 0.0),
        (-1.0, 0.0),
        (100.1, 0.0),
        (50.0, math.nan),
        (50.0, math.inf),
        (50.0, 50.1),
        (50.0, 1.7e308),
    ],
)
def test_an_absurd_report_is_silence(impp_kw: float, residual_kw: float) -> None:
    central = central_after_one_cycle()
    said = tell(
        central,
        dispatch(1, 120.0),
        *report("a", 1, 80.0, 20.0),
        *report("b", 1, impp_kw, residual_kw),
    )
    assert at(said, IMPP.of(ROOT)).power_kw == 170.0
    assert at(said, RESIDUAL.of(ROOT)).power_kw == 50.0
    assert setpoints_kw(said) == (60.0, 60.0)


@pytest.mark.parametrize("residual_kw", [-math.inf, -1.7e308, -100.1])
def test_a_child_that_claims_to_lack_more_than_its_rating_counts_as_silent(
    residual_kw: float,
) -> None:
    central = central_after_one_cycle()
    call = Help(1, CYCLE_NS, "b", (), missing_kw=-residual_kw)
    said = tell(
        central,
        dispatch(1, 120.0),
        *report("a", 1, 80.0, 20.0),
        *report("b", 1, 50.0, residual_kw),
        (HELP.of("b"), call),
    )
    assert at(said, IMPP.of(ROOT)).power_kw == 170.0
    assert at(said, RESIDUAL.of(ROOT)).power_kw == 50.0


@pytest.mark.parametrize("residual_kw", [50.0, 0.0, -100.0])
def test_a_residual_from_less_the_rating_up_to_the_impp_is_taken(residual_kw: float) -> None:
    central = central_after_one_cycle()
    call = Help(1, CYCLE_NS, "b", (), missing_kw=-residual_kw)
    said = tell(
        central,
        dispatch(1, 120.0),
        *report("a", 1, 80.0, 20.0),
        *([(HELP.of("b"), call)] if residual_kw < 0.0 else []),
        *report("b", 1, 50.0, residual_kw),
    )
    assert at(said, IMPP.of(ROOT)).power_kw == 130.0
    assert at(said, RESIDUAL.of(ROOT)).power_kw == 20.0 + residual_kw


def test_residuals_whose_sum_is_beyond_any_number_do_not_end_their_parent() -> None:
    central = in_real_time(central_controller(TWO), TWO)
    said = tell(
        central,
        dispatch(0, 120.0),
        *report("a", 0, 80.0, 1.7e308),
        *report("b", 0, 90.0, 1.7e308),
    )
    assert at(said, IMPP.of(ROOT)).power_kw == 0.0
    assert at(said, RESIDUAL.of(ROOT)).power_kw == -120.0


def test_a_child_that_has_never_spoken_has_nothing_to_give_but_is_let_try() -> None:
    central = in_real_time(central_controller(TWO), TWO)
    tell(central, dispatch(0, 120.0), *report("a", 0, 80.0, 20.0))
    said = dict(central.close_stage())
    assert at(said, IMPP.of(ROOT)).power_kw == 80.0
    assert setpoints_kw(said) == (80.0, 40.0)


def test_a_child_that_has_never_spoken_gets_no_setpoint_if_the_others_have_enough() -> None:
    central = in_real_time(central_controller(TWO), TWO)
    tell(central, dispatch(0, 80.0), *report("a", 0, 80.0, 40.0))
    assert setpoints_kw(dict(central.close_stage())) == (80.0, 0.0)


# A silent operator --------------------------------------------------------------------------------


def test_without_a_new_dispatch_the_last_one_holds() -> None:
    central = central_after_one_cycle()
    asked = dict(central.close_stage())
    assert at(asked, REQUEST.of("a")).power_kw == 60.0
    assert at(asked, REQUEST.of("a")).missing == ("dispatch",)
    said = tell(central, *report("a", 1, 80.0, 20.0), *report("b", 1, 90.0, 30.0))
    assert setpoints_kw(said) == (60.0, 60.0)


# A silent or absurd parent ------------------------------------------------------------------------

ABSURD_KW = [math.nan, math.inf, -math.inf, -1.0]


def supervisor_after_one_cycle() -> Sequencer[object]:
    """100 kW asked and set, both inverters could give 90 kW."""
    boss = in_real_time(supervisor(CLUSTER, "c1"), CLUSTER)
    tell(boss, request("c1", 0, 100.0))
    tell(boss, *report("c1/a", 0, 90.0, 40.0), *report("c1/b", 0, 90.0, 40.0))
    assert setpoints_kw(tell(boss, setpoint("c1", 0, 100.0))) == (50.0, 50.0)
    return boss


def test_without_a_word_of_its_parent_a_supervisor_goes_on_with_the_last() -> None:
    boss = supervisor_after_one_cycle()
    asked = dict(boss.close_stage())
    assert at(asked, REQUEST.of("c1/a")).power_kw == 50.0
    tell(boss, *report("c1/a", 1, 20.0, -30.0), *report("c1/b", 1, 90.0, 40.0))
    boss.close_stage()  # the call for help of c1/a does not come either
    said = dict(boss.close_stage())
    assert setpoints_kw(said) == (20.0, 80.0)
    assert at(said, SETPOINT.of("c1/a")).missing == ("c1/request", "c1/a/help", "c1/setpoint")


@pytest.mark.parametrize("absurd_kw", [*ABSURD_KW, 200.1, 1.7e308])
def test_a_supervisor_does_not_use_an_absurd_request_or_setpoint(absurd_kw: float) -> None:
    boss = supervisor_after_one_cycle()
    asked = tell(boss, request("c1", 1, absurd_kw))
    assert at(asked, REQUEST.of("c1/a")).power_kw == 50.0
    tell(boss, *report("c1/a", 1, 90.0, 40.0), *report("c1/b", 1, 90.0, 40.0))
    assert setpoints_kw(tell(boss, setpoint("c1", 1, absurd_kw))) == (50.0, 50.0)


@pytest.mark.parametrize("most_kw", [200.0, 200.0 * (1.0 + 1e-12)])
def test_a_supervisor_follows_its_parent_up_to_its_rating_and_a_rounding_error(
    most_kw: float,
) -> None:
    boss = supervisor_after_one_cycle()
    asked = tell(boss, request("c1", 1, most_kw))
    assert at(asked, REQUEST.of("c1/a")).power_kw == most_kw / 2.0
    tell(boss, *report("c1/a", 1, 100.0, 0.0), *report("c1/b", 1, 100.0, 0.0))
    assert setpoints_kw(tell(boss, setpoint("c1", 1, most_kw))) == (100.0, 100.0)


def direct_after_one_cycle() -> Sequencer[object]:
    """50 kW asked, 40 kW set; 80 kW could be given."""
    direct = in_real_time(direct_controller(CLUSTER, "c1/a"), CLUSTER)
    tell(direct, telemetry("c1/a", 0, 80.0, 1.0), request("c1/a", 0, 50.0))
    said = tell(direct, setpoint("c1/a", 0, 40.0))
    assert at(said, COMMAND.of("c1/a")).alpha == 0.5
    return direct


@pytest.mark.parametrize("absurd_kw", [*ABSURD_KW, 100.1, 1.7e308])
def test_a_direct_controller_does_not_use_an_absurd_request_or_setpoint(
    absurd_kw: float,
) -> None:
    direct = direct_after_one_cycle()
    said = tell(direct, telemetry("c1/a", 1, 40.0, 0.5), request("c1/a", 1, absurd_kw))
    assert at(said, RESIDUAL.of("c1/a")).power_kw == 30.0
    said = tell(direct, setpoint("c1/a", 1, absurd_kw))
    assert at(said, COMMAND.of("c1/a")).alpha == 0.5


@pytest.mark.parametrize("most_kw", [100.0, 100.0 * (1.0 + 1e-12)])
def test_a_direct_controller_follows_its_parent_up_to_its_rating_and_a_rounding_error(
    most_kw: float,
) -> None:
    direct = direct_after_one_cycle()
    said = tell(direct, telemetry("c1/a", 1, 40.0, 0.5), request("c1/a", 1, most_kw))
    assert at(said, RESIDUAL.of("c1/a")).power_kw == 80.0 - most_kw
    said = tell(direct, setpoint("c1/a", 1, most_kw))
    assert at(said, COMMAND.of("c1/a")).alpha == 1.0


def test_without_a_word_of_its_parent_a_direct_controller_keeps_request_and_setpoint() -> None:
    direct = direct_after_one_cycle()
    tell(direct, telemetry("c1/a", 1, 50.0, 0.5))  # brighter: 100 kW could be given now
    said = dict(direct.close_stage())
    assert at(said, RESIDUAL.of("c1/a")).power_kw == 50.0
    said = dict(direct.close_stage())
    assert at(said, COMMAND.of("c1/a")).alpha == 0.4
    assert at(said, COMMAND.of("c1/a")).missing == ("c1/a/request", "c1/a/setpoint")


def test_before_its_parents_first_word_an_inverter_is_let_free() -> None:
    direct = in_real_time(direct_controller(CLUSTER, "c1/a"), CLUSTER)
    tell(direct, telemetry("c1/a", 0, 80.0, 1.0))
    said = dict(direct.close_stage())
    assert at(said, RESIDUAL.of("c1/a")).power_kw == 80.0
    assert HELP.of("c1/a") not in said
    said = dict(direct.close_stage())
    assert at(said, COMMAND.of("c1/a")).alpha == 1.0


# A silent or absurd inverter ----------------------------------------------------------------------


def test_without_telemetry_the_last_impp_holds_and_its_age_is_counted() -> None:
    direct = direct_after_one_cycle()
    found = []
    for cycle in (1, 2):
        tell(direct, request("c1/a", cycle, 50.0))
        found.append(at(dict(direct.close_stage()), IMPP.of("c1/a")))
        tell(direct, setpoint("c1/a", cycle, 40.0))
    said = tell(direct, telemetry("c1/a", 3, 30.0, 0.5), request("c1/a", 3, 50.0))
    found.append(at(said, IMPP.of("c1/a")))
    assert [(impp.power_kw, impp.stale_cycles) for impp in found] == [
        (80.0, 1),
        (80.0, 2),
        (60.0, 0),
    ]
    assert [impp.missing for impp in found] == [("c1/a/telemetry",), ("c1/a/telemetry",), ()]


@pytest.mark.parametrize(
    ("power_kw", "alpha"),
    [(math.nan, 0.5), (-1.0, 0.5), (105.1, 1.0), (40.0, 0.0), (40.0, math.nan), (40.0, 1.1)],
)
def test_absurd_telemetry_is_as_good_as_none(power_kw: float, alpha: float) -> None:
    direct = direct_after_one_cycle()
    said = tell(direct, telemetry("c1/a", 1, power_kw, alpha), request("c1/a", 1, 50.0))
    impp = at(said, IMPP.of("c1/a"))
    assert (impp.power_kw, impp.stale_cycles) == (80.0, 1)


def test_before_the_first_telemetry_there_is_no_power_to_count_on() -> None:
    direct = in_real_time(
        DirectController("c1/a", 100.0, 0.05, CLUSTER.periods, "paper", "fraction"), CLUSTER
    )
    tell(direct, request("c1/a", 0, 50.0))
    said = dict(direct.close_stage())
    assert at(said, IMPP.of("c1/a")) == Impp(
        0, 0, "c1/a", ("c1/a/telemetry",), power_kw=0.0, stale_cycles=1
    )
    assert at(said, HELP.of("c1/a")).missing_kw == 50.0
