"""How an agent that stood still comes back to the cycle that is under way."""

from __future__ import annotations

import numpy as np
import pytest
from clerks import LISTEN_TO_BOTH, ORDER, ORDER_THEN_LISTEN, A, B, Desk, notices
from plants_by_hand import CYCLE_NS, at, plan_of, report, tell

from agents.agent import Stage
from agents.drops import Drops
from agents.sequencer import Sequencer
from agents.team import Controller, central_controller
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Message, Production, Telemetry
from bus_schemas.missing import skipped_cycles
from bus_schemas.signals import COMMAND, IMPP, PRODUCTION, Port
from bus_schemas.tree import ROOT
from sim_plant.plant import Plant
from sim_plant.profile import Profile


def a_desk(stages: tuple[Stage, ...] = LISTEN_TO_BOTH, horizon: int = 2) -> Desk:
    desk = Desk(stages, lockstep=False, horizon=horizon)
    desk.enter(0)
    return desk


def test_the_cycles_in_between_are_skipped_and_the_next_word_says_so() -> None:
    desk = a_desk()
    desk.sequencer.catch_up(60)
    assert (desk.sequencer.cycle, desk.sequencer.stage) == (60, "listen")
    assert desk.sequencer.skipped_cycles == 60
    assert desk.sequencer.missing_inputs == 0, "no deadline found them missing"
    desk.hear(A, 60)
    (said,) = notices(desk.sequencer.close_stage())
    assert said.missing == ("skipped@0", "b/residual")
    assert skipped_cycles(said.missing, said.cycle) == range(60)
    (said,) = notices(desk.sequencer.close_stage())
    assert said.missing == ("a/residual", "b/residual"), "it says so once"


def test_a_cycle_that_is_under_way_is_brought_to_its_end_first() -> None:
    desk = a_desk(ORDER_THEN_LISTEN)
    desk.hear(ORDER, 0)
    desk.hear(A, 0)
    said = notices(desk.sequencer.catch_up(5))
    assert [notice.text for notice in said] == [
        "0 listen: a/residual dispatch",
        # Nobody listens to a notice: it is sent for the skipped cycles too.
        *(f"{cycle} {stage}: nothing" for cycle in range(1, 5) for stage in ("order", "listen")),
    ]
    assert said[0].missing == ("b/residual",)
    assert said[1].missing == ("skipped@1", "dispatch")
    assert said[2].missing == ("skipped@1", "dispatch", "a/residual", "b/residual")
    assert skipped_cycles(said[2].missing, 1) == range(1, 2)
    assert desk.sequencer.cycle == 5


def test_the_newest_word_of_the_skipped_cycles_is_a_late_one() -> None:
    desk = a_desk(horizon=5)
    for cycle in range(4):
        desk.hear(A, cycle)
    desk.sequencer.catch_up(10)
    (said,) = notices(desk.sequencer.close_stage())
    assert said.text == "10 listen: a/residual@3"
    assert said.missing == ("skipped@0", "a/residual@3", "b/residual")
    assert desk.sequencer.drops == Drops(late=3)


def test_what_came_ahead_for_the_cycle_under_way_is_used_in_it() -> None:
    desk = a_desk(horizon=5)
    desk.hear(A, 4)
    desk.hear(A, 3)
    desk.hear(B, 4)
    said = notices(desk.sequencer.catch_up(4))
    assert [notice.text for notice in said][-1] == "4 listen: a/residual b/residual"
    assert said[-1].missing == ("skipped@0",)
    assert desk.sequencer.cycle == 5
    assert desk.sequencer.drops == Drops(late=1)


def test_a_late_word_that_waited_before_the_pause_waits_on() -> None:
    desk = a_desk()
    desk.sequencer.close_stage()
    desk.hear(B, 0)
    desk.sequencer.catch_up(7)
    (said,) = notices(desk.sequencer.close_stage())
    assert said.missing == ("skipped@1", "a/residual", "b/residual@0")


def test_nobody_catches_up_beyond_the_end() -> None:
    desk = a_desk()
    desk.sequencer.end_before(5)
    desk.sequencer.catch_up(60)
    assert desk.sequencer.cycle == 4
    # The last cycle is left, to say what became of the others.
    (said,) = notices(desk.sequencer.close_stage())
    assert said.missing == ("skipped@0", "a/residual", "b/residual")
    assert desk.sequencer.finished
    assert desk.sequencer.skipped_cycles == 4


def test_who_falls_behind_again_before_it_has_said_so_says_so_of_all() -> None:
    desk = a_desk(horizon=20)
    desk.sequencer.catch_up(10)
    desk.hear(A, 10)
    desk.sequencer.catch_up(15)
    (said,) = notices(desk.sequencer.close_stage())
    assert said.missing == ("skipped@0", "a/residual@10", "b/residual")
    assert desk.sequencer.skipped_cycles == 15
    desk.sequencer.catch_up(20)
    (said,) = notices(desk.sequencer.close_stage())
    assert skipped_cycles(said.missing, said.cycle) == range(16, 20)


@pytest.mark.parametrize("cycle", [-4, 0, 3])
def test_who_is_there_already_skips_nothing(cycle: int) -> None:
    desk = a_desk()
    for _ in range(3):
        desk.sequencer.close_stage()
    assert desk.sequencer.catch_up(cycle) == []
    assert (desk.sequencer.cycle, desk.sequencer.skipped_cycles) == (3, 0)


def test_neither_a_round_nor_lockstep_is_caught_up_with() -> None:
    desk = Desk(LISTEN_TO_BOTH, lockstep=False)
    desk.enter(-7)
    assert desk.sequencer.catch_up(5) == []
    assert desk.sequencer.cycle == -7
    desk = Desk(LISTEN_TO_BOTH, lockstep=True)
    desk.enter(0)
    assert desk.sequencer.catch_up(5) == []
    assert desk.sequencer.cycle == 0


def test_a_parent_counts_the_cycles_that_it_skipped_as_its_childrens_silence() -> None:
    plan = plan_of({"a": 100.0, "b": 100.0}, hold_cycles=3)
    for stood_still, expected_kw in [(2, 170.0), (3, 80.0)]:
        agent: Controller = central_controller(plan)
        central: Sequencer[object] = Sequencer(agent, plan.sim_time_ns, lockstep=False, horizon=1)
        central.enter(0)
        central.close_stage()
        tell(central, *report("a", 0, 80.0, 20.0), *report("b", 0, 90.0, 30.0))
        back = 1 + stood_still
        assert central.catch_up(back) == [], "nothing that others would act on"
        central.close_stage()
        tell(central, *report("a", back, 80.0, 20.0))
        said = dict(central.close_stage())
        assert at(said, IMPP.of(ROOT)).power_kw == expected_kw


# The plant ----------------------------------------------------------------------------------------

CYCLES = 8
MPP_KW = np.array([[10.0 * cycle, 100.0] for cycle in range(CYCLES)])


def a_plant() -> Sequencer[object]:
    plan = plan_of({"a": 100.0, "b": 100.0}, cycles=CYCLES)
    plant: Sequencer[object] = Sequencer(
        Plant(plan.tree, Profile(MPP_KW, np.full(CYCLES, 100.0))),  # type: ignore[arg-type]
        plan.sim_time_ns,
        lockstep=False,
        horizon=1,
    )
    plant.end_before(CYCLES)
    plant.enter(0)
    return plant


def produced(said: list[Delivery]) -> list[Production]:
    return [message for _, message in said if isinstance(message, Production)]


def command(node: str, cycle: int, alpha: float) -> Delivery:
    message = Command(cycle, cycle * CYCLE_NS, node, (), alpha=alpha, power_kw=100.0 * alpha)
    return COMMAND.of(node), message


def test_the_sun_goes_on_while_the_plant_stands_still_and_its_inverters_hold_their_commands() -> (
    None
):
    plant = a_plant()
    plant.close_stage()
    tell(plant, command("a", 0, 0.5), command("b", 0, 0.25))
    said = plant.catch_up(4)
    assert {port.signal for port, _ in said} == {PRODUCTION}, "old telemetry is of no use"
    found = produced(said)
    assert [message.cycle for message in found] == [1, 2, 3]
    assert [message.inverter_power_kw for message in found] == [
        (5.0, 25.0),
        (10.0, 25.0),
        (15.0, 25.0),
    ]
    assert found[1].missing == ("skipped@2", "a/command", "b/command")


def test_after_a_pause_the_plants_next_tick_measures_the_interval_before_it() -> None:
    plant = a_plant()
    plant.close_stage()
    tell(plant, command("a", 0, 0.5), command("b", 0, 0.25))
    plant.catch_up(4)
    said: dict[Port[Message], Message] = dict(plant.close_stage())
    measured = {str(port): message for port, message in said.items()}
    telemetry = measured["a/telemetry"]
    assert (telemetry.cycle, telemetry.missing) == (4, ("skipped@1",))
    assert isinstance(telemetry, Telemetry)
    assert telemetry.power_kw == 15.0


def test_no_interval_of_a_plant_that_stood_still_is_left_out() -> None:
    plant = a_plant()
    found = produced(plant.close_stage()) + produced(plant.close_stage())
    found += produced(plant.catch_up(5))
    while not plant.finished:
        found += produced(plant.close_stage())
    assert [message.cycle for message in found] == list(range(CYCLES))
