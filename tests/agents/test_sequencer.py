"""How an agent is taken through its cycles: what closes a stage, and what becomes of messages."""

from __future__ import annotations

import pytest
from clerks import (
    ASK,
    HELP_A,
    LISTEN_TO_BOTH,
    LISTEN_TO_PARENT,
    ORDER,
    ORDER_THEN_LISTEN,
    SET,
    TICK_THEN_LISTEN,
    A,
    B,
    Clerk,
    Desk,
    a_message,
    notices,
    texts,
)
from plants_by_hand import CYCLE_NS, plan_of, report

from agents.agent import Stage
from agents.drops import Drops
from agents.sequencer import BEFORE_ARMING, Sequencer
from agents.team import central_controller, direct_controller
from bus_schemas.messages import Command, Dispatch, Request, Residual, Setpoint, Telemetry
from bus_schemas.signals import COMMAND, REQUEST, RESIDUAL, SETPOINT, TELEMETRY
from bus_schemas.tree import CENTRAL

# What closes a stage ------------------------------------------------------------------------------


def test_a_stage_closes_with_the_last_message_that_it_awaits() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    assert desk.enter(0) == []
    assert desk.sequencer.waiting_for == {A, B}
    assert desk.sequencer.wanted == 2
    assert desk.hear(B, 0) == []
    assert desk.sequencer.waiting_for == {A}
    assert desk.sequencer.wanted == 1
    assert desk.hear(A, 0) == ["0 listen: a/residual b/residual"]


def test_the_next_cycle_opens_as_the_last_stage_closes() -> None:
    desk = Desk(ORDER_THEN_LISTEN)
    desk.enter(0)
    assert (desk.sequencer.cycle, desk.sequencer.stage) == (0, "order")
    desk.hear(ORDER, 0)
    assert (desk.sequencer.cycle, desk.sequencer.stage) == (0, "listen")
    desk.hear(A, 0)
    desk.hear(B, 0)
    assert (desk.sequencer.cycle, desk.sequencer.stage) == (1, "order")


def test_messages_of_a_later_stage_wait_for_it() -> None:
    desk = Desk(ORDER_THEN_LISTEN)
    desk.enter(0)
    assert desk.hear(A, 0) == []
    assert desk.hear(B, 0) == []
    assert desk.hear(ORDER, 0) == [
        "0 order: a/residual b/residual dispatch",
        "0 listen: a/residual b/residual dispatch",
    ]


def test_a_call_for_help_is_awaited_once_it_is_announced() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    desk.hear(A, 0, power_kw=-5.0)
    assert desk.sequencer.waiting_for == {B, HELP_A}
    assert desk.hear(B, 0) == []
    assert desk.hear(HELP_A, 0) == ["0 listen: a/help a/residual b/residual"]


def test_a_call_for_help_may_come_before_its_announcement() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    assert desk.hear(HELP_A, 0) == []
    desk.hear(B, 0)
    assert desk.hear(A, 0, power_kw=-5.0) == ["0 listen: a/help a/residual b/residual"]


def test_a_call_that_is_announced_during_an_earlier_stage_is_awaited_in_its_own() -> None:
    desk = Desk(ORDER_THEN_LISTEN)
    desk.enter(0)
    desk.hear(A, 0, power_kw=-5.0)
    desk.hear(B, 0)
    assert desk.hear(ORDER, 0) == ["0 order: a/residual b/residual dispatch"]
    assert desk.sequencer.waiting_for == {HELP_A}
    assert desk.hear(HELP_A, 0) == ["0 listen: a/help a/residual b/residual dispatch"]
    assert desk.sequencer.drops == Drops()


def test_a_call_that_is_announced_ahead_of_its_cycle_is_awaited_in_it() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    desk.hear(A, 1, power_kw=-5.0)
    desk.hear(B, 1)
    desk.hear(A, 0)
    assert desk.hear(B, 0) == ["0 listen: a/residual b/residual"]
    assert desk.sequencer.waiting_for == {HELP_A}
    assert desk.hear(HELP_A, 1) == ["1 listen: a/help a/residual b/residual"]
    assert desk.sequencer.drops == Drops()


def test_nobody_waits_for_help_where_power_is_left() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    desk.hear(A, 0, power_kw=0.0)
    assert desk.sequencer.waiting_for == {B}


def test_a_central_controller_waits_for_the_call_that_a_childs_residual_announces() -> None:
    plan = plan_of({"a": 100.0, "b": 100.0})
    central = Sequencer(central_controller(plan), plan.sim_time_ns, lockstep=True, horizon=1)
    central.enter(0)
    central.accept(ORDER, a_message(ORDER, 0))
    for port, message in [*report("a", 0, 0.0, -50.0), *report("b", 0, 80.0, 30.0)]:
        assert central.accept(port, message) == []
    assert central.waiting_for == {HELP_A}
    assert central.accept(HELP_A, a_message(HELP_A, 0)) != []
    assert central.cycle == 1


def test_a_direct_controller_waits_for_inverter_and_parent_then_for_its_setpoint() -> None:
    plan = plan_of({"a": 100.0})
    direct = Sequencer(direct_controller(plan, "a"), plan.sim_time_ns, lockstep=True, horizon=1)
    direct.enter(0)
    telemetry = Telemetry(0, 0, "plant", (), power_kw=40.0, alpha=0.5, limit_kw=100.0)
    request = Request(0, 0, CENTRAL, (), power_kw=60.0)
    setpoint = Setpoint(0, 0, CENTRAL, (), power_kw=60.0, share_kw=60.0, help_given=())
    assert direct.accept(TELEMETRY.of("a"), telemetry) == []
    assert direct.waiting_for == {REQUEST.of("a")}
    said = [str(port) for port, _ in direct.accept(REQUEST.of("a"), request)]
    assert said == ["a/impp", "a/residual"]
    assert direct.waiting_for == {SETPOINT.of("a")}
    said = [str(port) for port, _ in direct.accept(SETPOINT.of("a"), setpoint)]
    assert said == ["a/command"]


# Messages ahead -----------------------------------------------------------------------------------


def test_messages_ahead_are_kept_and_used_in_their_cycle() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    assert desk.hear(A, 2) == []
    assert desk.hear(A, 1) == []
    assert desk.hear(B, 1) == []
    assert desk.hear(A, 0) == []
    assert desk.hear(B, 0) == [
        "0 listen: a/residual b/residual",
        "1 listen: a/residual b/residual",
    ]
    assert desk.sequencer.waiting_for == {B}
    assert desk.hear(B, 2) == ["2 listen: a/residual b/residual"]
    assert desk.sequencer.drops == Drops()


def test_one_message_may_let_thousands_of_cycles_go_by_at_once() -> None:
    desk = Desk(LISTEN_TO_BOTH, horizon=5000)
    desk.enter(0)
    for cycle in range(5000):
        desk.hear(A, cycle)
        if cycle:
            desk.hear(B, cycle)
    said = desk.hear(B, 0)
    assert said == [f"{cycle} listen: a/residual b/residual" for cycle in range(5000)]
    assert desk.sequencer.cycle == 5000
    assert desk.sequencer.drops == Drops()


def test_a_message_beyond_the_horizon_is_dropped_and_named() -> None:
    desk = Desk(LISTEN_TO_BOTH, horizon=2)
    desk.enter(0)
    desk.hear(A, 2)
    desk.hear(A, 3)
    assert desk.sequencer.drops == Drops(other_cycle=1)
    assert desk.dropped == ["a/residual is of cycle 3, this is 0"]


# Messages that are of no use ----------------------------------------------------------------------


def test_a_message_of_an_earlier_cycle_is_late() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    desk.hear(A, 0)
    desk.hear(B, 0)
    assert desk.hear(A, 0) == []
    assert desk.sequencer.drops == Drops(late=1)
    assert desk.dropped == ["a/residual is of cycle 0, this is 1"]


def test_a_message_of_a_stage_that_is_over_is_late() -> None:
    desk = Desk(ORDER_THEN_LISTEN, lockstep=False, late="drop")
    desk.enter(0)
    desk.sequencer.close_stage()
    assert desk.hear(ORDER, 0) == []
    assert desk.sequencer.drops == Drops(late=1)
    assert desk.dropped == ["dispatch of cycle 0 came after its deadline"]


def test_of_two_messages_the_first_counts() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    desk.hear(A, 0, power_kw=1.0)
    desk.hear(A, 0, power_kw=-1.0)
    assert desk.sequencer.waiting_for == {B}
    assert desk.sequencer.drops == Drops(duplicate=1)
    assert desk.dropped == ["a/residual of cycle 0 came twice"]


def test_a_message_of_somebody_elses_making_is_foreign() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    assert desk.sequencer.accept(A, Residual(0, 0, "b", (), power_kw=1.0)) == []
    assert desk.sequencer.waiting_for == {A, B}
    assert desk.sequencer.drops == Drops(foreign=1)
    assert desk.dropped == ["a/residual of cycle 0 is from 'b'"]


def test_a_message_that_no_stage_awaits_is_unexpected() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    desk.hear(RESIDUAL.of("c"), 0)
    assert desk.sequencer.drops == Drops(unexpected=1)
    assert desk.dropped == ["c/residual is not expected in cycle 0"]


def test_drops_are_counted_by_the_port_they_came_on_too() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    desk.hear(A, 0)
    desk.hear(A, 0)
    desk.hear(A, 5)
    desk.hear(A, 6)
    desk.sequencer.accept(B, Residual(0, 0, "c", (), power_kw=1.0))
    assert desk.sequencer.dropped_ports == {
        "a/residual": {"duplicate": 1, "other_cycle": 2},
        "b/residual": {"foreign": 1},
    }
    assert desk.sequencer.drops.total() == 4


def test_drops_of_all_causes_add_up() -> None:
    assert Drops(late=1, other_cycle=2, unexpected=4, duplicate=8, foreign=16).total() == 31


# Arming rounds ------------------------------------------------------------------------------------


def test_the_first_message_from_above_takes_an_agent_into_its_round() -> None:
    desk = Desk(LISTEN_TO_PARENT)
    assert desk.sequencer.cycle == BEFORE_ARMING
    desk.hear(ASK, -7)
    assert desk.sequencer.cycle == -7
    assert desk.sequencer.waiting_for == {SET}


def test_a_round_ends_where_its_last_stage_closes() -> None:
    desk = Desk(LISTEN_TO_PARENT)
    desk.hear(ASK, -7)
    assert desk.hear(SET, -7) == ["-7 listen: a/request a/setpoint"]
    assert (desk.sequencer.cycle, desk.sequencer.stage) == (-7, "")
    assert desk.sequencer.waiting_for == frozenset()


def test_a_later_round_supersedes_an_open_one() -> None:
    desk = Desk(LISTEN_TO_PARENT)
    desk.hear(ASK, -7)
    assert desk.hear(SET, -6) == []
    assert desk.sequencer.cycle == -6
    assert desk.sequencer.waiting_for == {ASK}
    assert desk.hear(ASK, -6) == ["-6 listen: a/request a/setpoint"]


def test_what_is_left_of_an_earlier_round_is_dropped_without_a_word() -> None:
    desk = Desk(LISTEN_TO_PARENT)
    desk.hear(ASK, -6)
    desk.hear(SET, -7)
    desk.hear(ASK, -6)
    assert desk.sequencer.waiting_for == {SET}
    assert desk.sequencer.drops == Drops()
    assert desk.dropped == []


def test_a_foreign_message_is_counted_in_a_round_too() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.sequencer.accept(A, Residual(-7, 0, "b", (), power_kw=1.0))
    assert desk.sequencer.cycle == BEFORE_ARMING
    assert desk.sequencer.drops == Drops(foreign=1)


def test_rounds_leave_no_trace_in_the_state() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    counts = []
    for cycle in (-7, -6, 0, 1):
        if cycle <= 0:
            desk.enter(cycle)
        for port in (A, B):
            outputs = desk.sequencer.accept(port, a_message(port, cycle))
            counts += [notice.count for notice in notices(outputs)]
    # The clerk counts how often it has spoken: anew in each round and in the run, then onwards.
    assert counts == [1, 1, 1, 2]


def test_a_central_controller_forgets_the_dispatch_of_a_round() -> None:
    plan = plan_of({"a": 100.0, "b": 100.0})
    central = Sequencer(central_controller(plan), plan.sim_time_ns, lockstep=False, horizon=1)
    order = Dispatch(-1, 0, "plant", (), power_kw=120.0, commitment_kw=120.0, regulation_kw=0.0)
    asked = dict(central.accept(ORDER, order))
    assert asked[REQUEST.of("a")] == Request(-1, -CYCLE_NS, CENTRAL, (), power_kw=60.0)
    central.enter(0)
    asked = dict(central.close_stage())
    assert asked[REQUEST.of("a")] == Request(0, 0, CENTRAL, ("dispatch",), power_kw=0.0)


def test_messages_of_the_run_that_come_before_its_beginning_is_told_are_not_lost() -> None:
    desk = Desk(LISTEN_TO_PARENT)
    desk.hear(ASK, -7)
    desk.hear(SET, -7)
    desk.hear(ASK, 0)
    assert desk.sequencer.cycle == 0
    assert desk.hear(SET, 0) == ["0 listen: a/request a/setpoint"]


@pytest.mark.parametrize("rounds", [(), (-7,), (-7, -6)])
def test_a_run_that_is_first_heard_of_in_a_later_cycle_begins_at_cycle_0_all_the_same(
    rounds: tuple[int, ...],
) -> None:
    desk = Desk(LISTEN_TO_PARENT)
    for cycle in rounds:
        desk.hear(ASK, cycle)
        desk.hear(SET, cycle)
    assert desk.hear(ASK, 1) == []
    assert desk.sequencer.cycle == 0
    assert desk.sequencer.waiting_for == {ASK, SET}
    desk.hear(ASK, 0)
    outputs = desk.sequencer.accept(SET, a_message(SET, 0))
    outputs += desk.sequencer.accept(SET, a_message(SET, 1))
    # From the initial state, and with the message that came ahead.
    assert [(notice.text, notice.count) for notice in notices(outputs)] == [
        ("0 listen: a/request a/setpoint", 1),
        ("1 listen: a/request a/setpoint", 2),
    ]
    assert desk.sequencer.drops == Drops()


def test_an_open_round_leaves_nothing_in_a_run_first_heard_of_in_a_later_cycle() -> None:
    desk = Desk(LISTEN_TO_PARENT)
    desk.hear(ASK, -7)
    desk.hear(SET, 1)
    assert desk.sequencer.cycle == 0
    assert desk.sequencer.waiting_for == {ASK, SET}


def test_a_message_of_the_run_beyond_the_horizon_does_not_begin_it() -> None:
    desk = Desk(LISTEN_TO_PARENT, horizon=2)
    desk.hear(ASK, -7)
    desk.hear(SET, -7)
    assert desk.hear(ASK, 3) == []
    assert desk.sequencer.cycle == -7
    assert desk.sequencer.drops == Drops(other_cycle=1)
    assert desk.dropped == ["a/request is of cycle 3, this is -7"]


@pytest.mark.parametrize("cycle", [-8, -5, -1, 0, 2])
def test_a_child_that_speaks_out_of_turn_takes_its_parent_nowhere(cycle: int) -> None:
    desk = Desk(ORDER_THEN_LISTEN, horizon=2)
    for first_round in (-7, -6):
        before = desk.sequencer.cycle
        assert desk.hear(A, cycle) == []
        assert desk.sequencer.cycle == before
        desk.hear(ORDER, first_round)
        assert desk.hear(A, first_round) == []
        assert desk.hear(B, first_round) == [
            f"{first_round} listen: a/residual b/residual dispatch"
        ]
    desk.hear(ORDER, 0)
    assert desk.sequencer.cycle == 0
    assert desk.sequencer.waiting_for == {A, B}, "what came before the run is not of the run"


def test_a_child_that_answers_a_round_before_its_parent_has_heard_of_it_is_heard_all_the_same() -> (
    None
):
    desk = Desk(ORDER_THEN_LISTEN)
    desk.hear(ORDER, -7)
    desk.hear(A, -6)
    assert desk.sequencer.cycle == -7
    desk.hear(ORDER, -6)
    assert desk.sequencer.waiting_for == {B}


def test_a_round_that_nobody_from_above_has_begun_is_named() -> None:
    desk = Desk(ORDER_THEN_LISTEN)
    desk.hear(A, -5)
    assert desk.dropped == ["a/residual is of cycle -5, this is before all cycles"]


def test_a_plant_is_taken_into_its_rounds_by_nobody() -> None:
    plan = plan_of({"a": 100.0})
    desk: Sequencer[int] = Sequencer(
        Clerk((Stage("advance", frozenset({COMMAND.of("a")})),), "plant"),
        plan.sim_time_ns,
        lockstep=True,
        horizon=1,
    )
    desk.enter(-7)
    desk.accept(COMMAND.of("a"), Command(0, 0, "a", (), alpha=0.5, power_kw=1.0))
    assert desk.cycle == -7


# Deadlines ----------------------------------------------------------------------------------------


def test_a_deadline_closes_the_stage_with_what_is_there_and_names_what_is_not() -> None:
    desk = Desk(LISTEN_TO_BOTH, lockstep=False)
    desk.enter(0)
    desk.hear(A, 0)
    (said,) = notices(desk.sequencer.close_stage())
    assert said.text == "0 listen: a/residual"
    assert said.missing == ("b/residual",)
    assert desk.sequencer.missing_inputs == 1
    assert desk.sequencer.cycle == 1


def test_an_announced_call_for_help_that_does_not_come_is_named_as_missing() -> None:
    desk = Desk(LISTEN_TO_BOTH, lockstep=False)
    desk.enter(0)
    desk.hear(A, 0, power_kw=-1.0)
    desk.hear(B, 0)
    (said,) = notices(desk.sequencer.close_stage())
    assert said.missing == ("a/help",)


def test_what_a_cycle_lacked_is_named_up_to_its_end_and_no_longer() -> None:
    desk = Desk(ORDER_THEN_LISTEN, lockstep=False)
    desk.enter(0)
    missing = []
    for _ in range(2):
        missing += [notice.missing for notice in notices(desk.sequencer.close_stage())]
    desk.hear(ORDER, 1)
    desk.hear(A, 1)
    outputs = desk.sequencer.accept(B, a_message(B, 1))
    missing += [notice.missing for notice in notices(outputs)]
    assert missing == [("dispatch",), ("dispatch", "a/residual", "b/residual"), ()]
    assert desk.sequencer.missing_inputs == 3


def test_a_complete_cycle_names_nothing_as_missing() -> None:
    desk = Desk(LISTEN_TO_BOTH, lockstep=False)
    desk.enter(0)
    desk.hear(A, 0)
    (said,) = notices(desk.sequencer.accept(B, a_message(B, 0)))
    assert said.missing == ()
    assert desk.sequencer.missing_inputs == 0


def test_a_deadline_between_rounds_closes_nothing() -> None:
    desk = Desk(LISTEN_TO_PARENT, lockstep=False)
    desk.hear(ASK, -7)
    desk.hear(SET, -7)
    assert desk.sequencer.close_stage() == []
    assert desk.sequencer.cycle == -7


# Timed stages -------------------------------------------------------------------------------------


def test_a_timed_stage_closes_at_once_in_lockstep() -> None:
    desk = Desk(TICK_THEN_LISTEN, lockstep=True)
    assert desk.enter(0) == ["0 tick: nothing"]
    assert desk.hear(A, 0) == ["0 listen: a/residual", "1 tick: nothing"]


def test_a_timed_stage_waits_for_the_clock_in_real_time() -> None:
    desk = Desk(TICK_THEN_LISTEN, lockstep=False)
    assert desk.enter(0) == []
    assert desk.sequencer.stage == "tick"
    assert texts(desk.sequencer.close_stage()) == ["0 tick: nothing"]
    assert desk.sequencer.missing_inputs == 0
    assert desk.hear(A, 0) == ["0 listen: a/residual"]
    assert (desk.sequencer.cycle, desk.sequencer.stage) == (1, "tick")


@pytest.mark.parametrize("lockstep", [True, False])
def test_a_round_has_no_clock(lockstep: bool) -> None:
    desk = Desk(TICK_THEN_LISTEN, lockstep=lockstep)
    assert desk.enter(-7) == ["-7 tick: nothing"]
    assert desk.hear(A, -7) == ["-7 listen: a/residual"]


def test_one_deadline_opens_one_timed_stage() -> None:
    desk = Desk(TICK_THEN_LISTEN, lockstep=False)
    desk.enter(0)
    desk.sequencer.close_stage()
    assert texts(desk.sequencer.close_stage()) == ["0 listen: nothing"]
    assert (desk.sequencer.cycle, desk.sequencer.stage) == (1, "tick")


def test_messages_do_not_open_a_timed_stage_before_its_time() -> None:
    desk = Desk(TICK_THEN_LISTEN, lockstep=False)
    desk.enter(0)
    assert desk.hear(A, 0) == []
    assert texts(desk.sequencer.close_stage()) == ["0 tick: a/residual", "0 listen: a/residual"]


# The end ------------------------------------------------------------------------------------------


def test_a_run_ends_before_the_cycle_that_does_not_take_place() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.sequencer.end_before(2)
    desk.enter(0)
    for cycle in (0, 1):
        assert not desk.sequencer.finished
        desk.hear(A, cycle)
        desk.hear(B, cycle)
    assert desk.sequencer.finished
    assert (desk.sequencer.stage, desk.sequencer.waiting_for) == ("", frozenset())
    assert desk.sequencer.close_stage() == []


def test_an_end_that_is_told_late_lets_the_open_cycle_be_the_last() -> None:
    desk = Desk(LISTEN_TO_BOTH)
    desk.enter(0)
    desk.hear(A, 0)
    desk.sequencer.end_before(1)
    assert not desk.sequencer.finished
    assert desk.hear(B, 0) == ["0 listen: a/residual b/residual"]
    assert desk.sequencer.finished


@pytest.mark.parametrize("lockstep", [True, False])
def test_a_run_of_no_cycles_is_over_at_once(lockstep: bool) -> None:
    desk = Desk(TICK_THEN_LISTEN, lockstep=lockstep)
    desk.sequencer.end_before(0)
    assert desk.enter(0) == []
    assert desk.sequencer.finished
