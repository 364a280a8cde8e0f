"""What becomes of a word that comes after its stage has closed, in real time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from clerks import (
    HELP_A,
    LISTEN_TO_BOTH,
    ORDER,
    ORDER_THEN_LISTEN,
    A,
    B,
    Desk,
    a_message,
    notices,
)
from plants_by_hand import CYCLE_NS, at, plan_of, report, tell

from agents.agent import Stage
from agents.drops import Drops
from agents.sequencer import Sequencer
from agents.team import Controller, central_controller, direct_controller, supervisor
from bus_schemas.bus import Delivery
from bus_schemas.messages import (
    Command,
    Dispatch,
    Message,
    Notice,
    Production,
    Request,
    Residual,
    Setpoint,
    Telemetry,
)
from bus_schemas.signals import (
    COMMAND,
    DISPATCH,
    IMPP,
    REQUEST,
    RESIDUAL,
    SETPOINT,
    TELEMETRY,
    Port,
)
from bus_schemas.tree import ROOT
from sim_plant.plant import Plant
from sim_plant.profile import Profile


def a_desk(stages: tuple[Stage, ...] = LISTEN_TO_BOTH) -> Desk:
    """A desk in real time, in cycle 0."""
    desk = Desk(stages, lockstep=False)
    desk.enter(0)
    return desk


def close(desk: Desk) -> Notice:
    """What is said as a deadline passes."""
    (said,) = notices(desk.sequencer.close_stage())
    return said


# In place of what does not come in time -----------------------------------------------------------


def test_a_late_word_is_used_where_the_next_one_does_not_come_in_time() -> None:
    desk = a_desk()
    desk.hear(A, 0)
    assert close(desk).missing == ("b/residual",)
    assert desk.hear(B, 0) == []  # it comes in cycle 1
    desk.hear(A, 1)
    said = close(desk)
    assert said.text == "1 listen: a/residual b/residual@0"
    assert said.missing == ("b/residual@0",)
    assert desk.sequencer.late_used == 1
    assert desk.sequencer.missing_inputs == 2, "neither was there at its deadline"
    assert desk.sequencer.drops == Drops()


def test_a_word_that_comes_in_its_cycle_but_after_its_stage_serves_the_next_cycle() -> None:
    desk = a_desk(ORDER_THEN_LISTEN)
    close(desk)
    assert desk.hear(ORDER, 0) == []
    desk.hear(A, 0)
    desk.hear(B, 0)
    said = close(desk)
    assert (said.text, said.missing) == ("1 order: dispatch@0", ("dispatch@0",))


def test_the_word_whose_place_a_late_one_took_serves_the_next_cycle() -> None:
    desk = a_desk(ORDER_THEN_LISTEN)
    close(desk)
    desk.hear(ORDER, 0)
    close(desk)
    assert close(desk).missing == ("dispatch@0",)
    desk.hear(ORDER, 1)  # in cycle 1, after the stage that used the one of cycle 0
    assert desk.sequencer.drops == Drops()
    close(desk)
    assert close(desk).missing == ("dispatch@1",)


def test_each_late_word_is_used_once() -> None:
    desk = a_desk()
    close(desk)
    desk.hear(A, 0)
    desk.hear(B, 0)
    assert close(desk).missing == ("a/residual@0", "b/residual@0")
    assert close(desk).missing == ("a/residual", "b/residual")


def test_a_delay_of_one_cycle_on_every_message_silences_nobody() -> None:
    desk = a_desk()
    missing = []
    for cycle in range(1, 6):
        missing.append(close(desk).missing)
        desk.hear(A, cycle - 1)
        desk.hear(B, cycle - 1)
    expected = [(f"a/residual@{cycle}", f"b/residual@{cycle}") for cycle in range(4)]
    assert missing == [("a/residual", "b/residual"), *expected]
    assert desk.sequencer.late_used == 8
    assert desk.sequencer.drops == Drops()


def test_a_late_word_does_not_close_a_stage_that_may_still_be_complete() -> None:
    desk = a_desk()
    close(desk)
    desk.hear(A, 0)
    desk.hear(B, 0)
    assert desk.sequencer.waiting_for == {A, B}
    desk.hear(A, 1)
    assert desk.hear(B, 1) == ["1 listen: a/residual b/residual"]


# Of several the newest ----------------------------------------------------------------------------


def test_of_several_late_words_the_newest_is_used_whatever_their_order() -> None:
    desk = a_desk()
    for _ in range(3):
        close(desk)
    for cycle in (1, 2, 0):
        desk.hear(A, cycle)
    assert close(desk).missing == ("a/residual@2", "b/residual")
    assert desk.sequencer.drops == Drops(late=2)
    assert desk.dropped == [
        "a/residual is of cycle 1, this is 3",
        "a/residual is of cycle 0, this is 3",
    ]
    assert desk.sequencer.dropped_ports == {"a/residual": {"late": 2}}


def test_a_late_word_gives_way_to_the_one_that_comes_in_time() -> None:
    desk = a_desk()
    close(desk)
    desk.hear(A, 0)
    desk.hear(A, 1)
    assert desk.sequencer.drops == Drops(late=1)
    assert close(desk).missing == ("b/residual",)


def test_what_is_older_than_the_word_last_used_is_dropped() -> None:
    desk = a_desk()
    close(desk)
    desk.hear(A, 1)
    close(desk)
    desk.hear(A, 0)
    assert desk.sequencer.drops == Drops(late=1)
    assert close(desk).missing == ("a/residual", "b/residual")


def test_a_second_copy_of_a_late_word_is_dropped() -> None:
    desk = a_desk()
    close(desk)
    desk.hear(A, 0)
    desk.hear(A, 0)
    close(desk)
    desk.hear(A, 0)
    assert desk.sequencer.drops == Drops(late=2)
    assert desk.sequencer.late_used == 1


def test_a_late_word_on_a_port_that_expects_none_is_unexpected() -> None:
    desk = a_desk()
    close(desk)
    desk.hear(RESIDUAL.of("c"), 0)
    assert desk.sequencer.drops == Drops(unexpected=1)


def test_late_words_that_nobody_came_to_use_are_dropped_at_the_end() -> None:
    desk = a_desk()
    desk.sequencer.end_before(2)
    close(desk)
    desk.hear(HELP_A, 0)
    close(desk)
    assert desk.sequencer.finished
    assert desk.sequencer.drops == Drops(late=1)
    desk.hear(B, 1)
    assert desk.sequencer.drops == Drops(late=2)


def test_late_words_are_dropped_too_where_the_end_is_told_late() -> None:
    desk = a_desk()
    close(desk)
    desk.hear(A, 0)
    desk.sequencer.end_before(1)
    assert desk.sequencer.finished
    assert desk.sequencer.drops == Drops(late=1)


# Where they may not be used -----------------------------------------------------------------------


def test_late_words_can_be_dropped_instead() -> None:
    desk = Desk(LISTEN_TO_BOTH, lockstep=False, late="drop")
    desk.enter(0)
    close(desk)
    desk.hear(A, 0)
    assert desk.sequencer.drops == Drops(late=1)
    assert close(desk).missing == ("a/residual", "b/residual")


def test_in_lockstep_nothing_is_ever_late_but_what_comes_twice() -> None:
    desk = Desk(LISTEN_TO_BOTH, lockstep=True)
    desk.enter(0)
    desk.hear(A, 0)
    desk.hear(B, 0)
    desk.hear(A, 0)
    assert desk.sequencer.drops == Drops(late=1)


def test_no_word_of_an_arming_round_is_used_in_the_run() -> None:
    desk = Desk(LISTEN_TO_BOTH, lockstep=False)
    desk.enter(-7)
    desk.hear(A, -7)
    desk.enter(-6)
    desk.hear(A, -6)
    desk.hear(B, -7)
    desk.enter(0)
    desk.hear(B, -6)
    assert desk.sequencer.drops == Drops(late=1)
    assert close(desk).missing == ("a/residual", "b/residual")


def test_no_late_word_survives_a_new_beginning() -> None:
    desk = a_desk()
    close(desk)
    desk.hear(A, 0)
    desk.enter(0)
    assert close(desk).missing == ("a/residual", "b/residual")


# Calls for help -----------------------------------------------------------------------------------


def test_the_call_that_a_late_residual_announces_is_named_whether_it_came_or_not() -> None:
    desk = a_desk()
    close(desk)
    desk.hear(A, 0, power_kw=-5.0)
    desk.hear(B, 1)
    assert close(desk).missing == ("a/help", "a/residual@0")
    desk.hear(A, 1, power_kw=-5.0)
    desk.hear(HELP_A, 1)
    desk.hear(B, 2)
    said = close(desk)
    assert said.text == "2 listen: a/help@1 a/residual@1 b/residual"
    assert said.missing == ("a/help@1", "a/residual@1")


def test_a_late_call_serves_a_residual_that_came_in_time() -> None:
    desk = a_desk()
    desk.hear(B, 0)
    desk.hear(A, 0, power_kw=-5.0)
    assert close(desk).missing == ("a/help",)
    desk.hear(HELP_A, 0)
    desk.hear(B, 1)
    desk.hear(A, 1, power_kw=-5.0)
    assert desk.sequencer.waiting_for == {HELP_A}
    assert close(desk).missing == ("a/help@0",)


def test_a_late_call_that_nothing_announces_is_not_used() -> None:
    desk = a_desk()
    close(desk)
    desk.hear(HELP_A, 0)
    desk.hear(A, 1, power_kw=5.0)
    assert close(desk).missing == ("b/residual",)


# Each agent of the plant --------------------------------------------------------------------------

FLAT = plan_of({"a": 100.0, "b": 100.0}, hold_cycles=2)
CLUSTER = plan_of({"c1/a": 100.0, "c1/b": 100.0}, period_cycles=(60, 10))


def in_real_time(agent: Controller | Plant, horizon: int = 60) -> Sequencer[object]:
    sequencer: Sequencer[object] = Sequencer(
        agent,  # type: ignore[arg-type]
        lambda cycle: cycle * CYCLE_NS,
        lockstep=False,
        horizon=horizon,
    )
    sequencer.enter(0)
    return sequencer


Said = Mapping[Port[Message], Message]


def dispatch(cycle: int, power_kw: float) -> Delivery:
    stamp = (cycle, cycle * CYCLE_NS, "plant", ())
    return DISPATCH.of(ROOT), Dispatch(
        *stamp, power_kw=power_kw, commitment_kw=power_kw, regulation_kw=0.0
    )


def request(node: str, cycle: int, power_kw: float) -> Delivery:
    port = REQUEST.of(node)
    return port, Request(cycle, cycle * CYCLE_NS, port.publisher, (), power_kw=power_kw)


def setpoint(node: str, cycle: int, power_kw: float) -> Delivery:
    port = SETPOINT.of(node)
    stamp = (cycle, cycle * CYCLE_NS, port.publisher, ())
    return port, Setpoint(*stamp, power_kw=power_kw, share_kw=power_kw, help_given=())


def telemetry(node: str, cycle: int, power_kw: float, alpha: float) -> Delivery:
    stamp = (cycle, cycle * CYCLE_NS, "plant", ())
    return TELEMETRY.of(node), Telemetry(*stamp, power_kw=power_kw, alpha=alpha, limit_kw=100.0)


def test_a_late_report_counts_as_a_word_of_a_child_that_lives() -> None:
    central = in_real_time(central_controller(FLAT))
    tell(central, dispatch(0, 120.0), *report("a", 0, 80.0, 20.0))
    central.close_stage()
    impps_kw = []
    # b is always a cycle late. Silent, it would count as zero after two cycles.
    for cycle in range(1, 6):
        tell(central, *report("b", cycle - 1, 60.0 + cycle, 0.0))
        tell(central, dispatch(cycle, 120.0), *report("a", cycle, 80.0, 20.0))
        impps_kw.append(at(dict(central.close_stage()), IMPP.of(ROOT)).power_kw)
    assert impps_kw == [141.0, 142.0, 143.0, 144.0, 145.0]


def reported_of_b(impp_cycle: int, impp_kw: float, residual_kw: float) -> Said:
    """What is said in cycle 1, in which b's two words are of one cycle each: 0 and 1.

    Of 120 kW b is asked for 60. It is a that could give 20 kW more.
    """
    central = in_real_time(central_controller(FLAT))
    tell(central, dispatch(0, 120.0), *report("a", 0, 80.0, 20.0))
    central.close_stage()
    impp, _ = report("b", impp_cycle, impp_kw, 0.0)
    _, residual = report("b", 1 - impp_cycle, 0.0, residual_kw)
    tell(central, impp, residual, dispatch(1, 120.0), *report("a", 1, 80.0, 20.0))
    said = dict(central.close_stage())
    late = "impp" if impp_cycle == 0 else "residual"
    assert f"b/{late}@0" in said[IMPP.of(ROOT)].missing
    return said


@pytest.mark.parametrize("impp_cycle", [0, 1])
@pytest.mark.parametrize(("impp_kw", "residual_kw"), [(30.0, 40.0), (90.0, 20.0), (90.0, -50.0)])
def test_a_residual_of_another_cycle_than_the_impp_is_worked_out_anew(
    impp_cycle: int, impp_kw: float, residual_kw: float
) -> None:
    # No child can have 40 kW left of 30: taken together, the two words would be absurd.
    said = reported_of_b(impp_cycle, impp_kw, residual_kw)
    assert at(said, IMPP.of(ROOT)).power_kw == 80.0 + impp_kw
    assert at(said, RESIDUAL.of(ROOT)).power_kw == 20.0 + (impp_kw - 60.0)


@pytest.mark.parametrize("impp_kw", [float("nan"), -1.0, 100.1])
def test_an_absurd_late_impp_is_not_taken(impp_kw: float) -> None:
    assert at(reported_of_b(0, impp_kw, 20.0), IMPP.of(ROOT)).power_kw == 80.0


def test_what_late_reports_lack_is_lent_to_their_children() -> None:
    central = in_real_time(central_controller(FLAT))
    tell(central, dispatch(0, 120.0))
    central.close_stage()
    tell(central, dispatch(1, 120.0), *report("a", 0, 20.0, -40.0), *report("b", 0, 40.0, -20.0))
    said = dict(central.close_stage())
    # a lacked 40 kW a cycle ago and b 20: they may have them now. Together it is the target.
    assert [at(said, SETPOINT.of(child)).power_kw for child in ("a", "b")] == [60.0, 60.0]
    tell(central, dispatch(2, 120.0), *report("a", 2, 20.0, -40.0), *report("b", 2, 40.0, -20.0))
    said = dict(central.close_stage())
    assert [at(said, SETPOINT.of(child)).power_kw for child in ("a", "b")] == [20.0, 40.0]


def test_late_reports_that_lack_nothing_change_no_setpoint() -> None:
    central = in_real_time(central_controller(FLAT))
    tell(central, dispatch(0, 120.0))
    central.close_stage()
    tell(central, dispatch(1, 120.0), *report("a", 0, 20.0, -40.0), *report("b", 0, 100.0, 40.0))
    said = dict(central.close_stage())
    assert [at(said, SETPOINT.of(child)).power_kw for child in ("a", "b")] == [20.0, 100.0]


def test_a_late_dispatch_is_followed() -> None:
    central = in_real_time(central_controller(FLAT))
    central.close_stage()
    central.close_stage()
    tell(central, dispatch(0, 120.0))
    asked = dict(central.close_stage())
    assert at(asked, REQUEST.of("a")).power_kw == 60.0
    assert at(asked, REQUEST.of("a")).missing == ("dispatch@0",)


def test_late_telemetry_gives_an_estimate_from_power_and_alpha_of_one_interval() -> None:
    direct = in_real_time(direct_controller(plan_of({"a": 100.0}), "a"))
    tell(direct, request("a", 0, 50.0))
    direct.close_stage()
    tell(direct, setpoint("a", 0, 40.0))
    tell(direct, telemetry("a", 0, 40.0, 0.5), request("a", 1, 50.0))
    impp = at(dict(direct.close_stage()), IMPP.of("a"))
    assert (impp.power_kw, impp.stale_cycles, impp.missing) == (80.0, 0, ("a/telemetry@0",))


def test_a_late_setpoint_makes_the_next_command() -> None:
    direct = in_real_time(direct_controller(plan_of({"a": 100.0}), "a"))
    tell(direct, telemetry("a", 0, 80.0, 1.0), request("a", 0, 50.0))
    direct.close_stage()
    tell(direct, setpoint("a", 0, 40.0))
    tell(direct, telemetry("a", 1, 80.0, 1.0), request("a", 1, 50.0))
    command = at(dict(direct.close_stage()), COMMAND.of("a"))
    assert (command.alpha, command.missing) == (0.5, ("a/setpoint@0",))


def test_a_late_command_is_obeyed() -> None:
    plan = plan_of({"a": 100.0, "b": 100.0})
    profile = Profile(np.full((3, 2), 100.0), np.full(3, 100.0))
    plant = in_real_time(Plant(plan.tree, profile))
    port = COMMAND.of("a")
    for _ in range(2):
        plant.close_stage()
    tell(plant, (port, Command(0, 0, "a", (), alpha=0.25, power_kw=25.0)))
    plant.close_stage()
    (production,) = (message for _, message in plant.close_stage() if message.source == "plant")
    assert isinstance(production, Production)
    assert production.missing == ("a/command@0", "b/command")
    assert production.inverter_power_kw == (25.0, 100.0)


# Words of a parent that acts rarely ---------------------------------------------------------------


def supervisor_up_to(cycle: int) -> Sequencer[object]:
    """A supervisor that acts every 10 cycles, below a central controller that acts every 60.

    It has heard its children up to a cycle, and of its parent nothing but that of cycle 0.
    """
    boss = in_real_time(supervisor(CLUSTER, "c1"))
    tell(boss, request("c1", 0, 100.0))
    children(boss, 0)
    tell(boss, setpoint("c1", 0, 100.0))
    for number in range(1, cycle):
        children(boss, number)
        while boss.cycle == number:
            boss.close_stage()
    return boss


def children(boss: Sequencer[object], cycle: int) -> dict[Port[Message], Message]:
    return tell(boss, *report("c1/a", cycle, 90.0, 40.0), *report("c1/b", cycle, 90.0, 40.0))


def test_a_setpoint_that_missed_its_turn_is_taken_up_in_the_childs_next_turn() -> None:
    boss = supervisor_up_to(62)
    tell(boss, request("c1", 60, 160.0), setpoint("c1", 60, 160.0))
    for cycle in range(62, 70):
        said = children(boss, cycle)
        assert not any(isinstance(message, Setpoint) for message in said.values())
        assert at(said, IMPP.of("c1")).missing == ()
    # The request stage of cycle 70 awaits nothing: it closes with the end of cycle 69.
    assert at(said, REQUEST.of("c1/a")).missing == ("c1/request@60",)
    said = children(boss, 70)
    assert at(said, SETPOINT.of("c1/a")).power_kw == 80.0
    assert at(said, SETPOINT.of("c1/a")).missing == ("c1/request@60", "c1/setpoint@60")
    assert boss.late_used == 2


def test_a_late_request_is_passed_on_in_the_childs_next_turn() -> None:
    boss = supervisor_up_to(69)
    tell(boss, request("c1", 60, 160.0))
    said = children(boss, 69)
    assert at(said, REQUEST.of("c1/a")) == Request(
        70, 70 * CYCLE_NS, "c1", ("c1/request@60",), power_kw=80.0
    )


def test_an_inverter_takes_up_its_parents_late_word_in_the_cycle_in_which_it_comes() -> None:
    direct = in_real_time(direct_controller(CLUSTER, "c1/a"))
    tell(direct, telemetry("c1/a", 0, 80.0, 1.0))
    direct.close_stage()
    direct.close_stage()
    tell(direct, telemetry("c1/a", 1, 80.0, 1.0))
    tell(direct, setpoint("c1/a", 0, 40.0), request("c1/a", 0, 50.0))
    said = tell(direct, telemetry("c1/a", 2, 80.0, 1.0))
    assert at(said, RESIDUAL.of("c1/a")) == Residual(
        2, 2 * CYCLE_NS, "c1/a", ("c1/a/request@0",), power_kw=30.0
    )
    assert at(said, COMMAND.of("c1/a")).alpha == 0.5
    assert at(said, COMMAND.of("c1/a")).missing == ("c1/a/request@0", "c1/a/setpoint@0")
    assert direct.missing_inputs == 2, "those of cycle 0: in cycle 2 nobody waited for them"
    # The next cycle is as any other.
    said = tell(direct, telemetry("c1/a", 3, 40.0, 0.5))
    assert {message.missing for message in said.values()} == {()}


def test_a_word_for_a_cycle_that_was_not_the_parents_turn_is_not_taken_up() -> None:
    boss = supervisor_up_to(62)
    tell(boss, setpoint("c1", 61, 160.0))
    assert boss.drops == Drops(unexpected=1)


@pytest.mark.parametrize("late_by", [1, 3, 9])
def test_the_next_word_in_time_takes_the_place_of_a_late_one(late_by: int) -> None:
    boss = supervisor_up_to(60 + late_by)
    tell(boss, setpoint("c1", 60, 160.0))
    for cycle in range(60 + late_by, 120):
        children(boss, cycle)
    tell(boss, request("c1", 120, 100.0))
    children(boss, 120)
    said = tell(boss, setpoint("c1", 120, 100.0))
    assert at(said, SETPOINT.of("c1/a")).power_kw == 50.0
    assert at(said, SETPOINT.of("c1/a")).missing == ()


def test_a_message_from_before_the_run_is_no_late_word() -> None:
    desk = a_desk()
    desk.sequencer.accept(A, a_message(A, -3))
    assert close(desk).missing == ("a/residual", "b/residual")
