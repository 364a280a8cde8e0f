"""Of each input the newest message and its age: which one a stage uses, and what it says of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import AtWork, at, dispatch, impp, setpoint

from agents.agent import Stage, Turn
from agents.loop import AgentLoop
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message, Notice
from bus_schemas.missing import parse_missing
from bus_schemas.signals import DISPATCH, IMPP, NOTICE, RUN, SETPOINT, Port
from bus_schemas.tree import ROOT

A, B, SET, WISH = IMPP.of("c1/a"), IMPP.of("c1/b"), SETPOINT.of("c1"), DISPATCH.of(ROOT)
SENT = NOTICE.of("c1")
HOLD = 3
TURN = 5


def plan(**changes: object) -> RunPlan:
    """Two inverters below `c1`, whose parent acts every fifth cycle."""
    ratings_kw = {"c1/a": 100.0, "c1/b": 100.0}
    changes = {"cycles": 100, "period_cycles": (TURN, 1), "hold_cycles": HOLD} | changes
    return plan_of(ratings_kw, **changes)


LOCKSTEP = plan()
ON_THE_CLOCK = plan(cycle_wall_ns=REAL_TIME)


@dataclass
class Clerk:
    """An agent with one stage, which writes down what it is given."""

    awaits: tuple[Port[Message], ...] = (A, B)
    uses: tuple[Port[Message], ...] = ()
    may_skip: bool = True
    name: str = "c1"

    def initial_state(self) -> int:
        return 0

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        return (Stage("report", self.awaits, self.uses),)

    def step(self, state: int, turn: Turn) -> tuple[int, list[Delivery]]:
        found = {str(port): turn.inputs[port] for port in (*self.awaits, *self.uses)}
        text = " ".join(f"{key}@{m.cycle}" if m else f"{key}@-" for key, m in found.items())
        return state + 1, [(SENT, Notice(*turn.stamp, text=text, count=state + 1))]


def both(cycle: int) -> tuple[Delivery, Delivery]:
    return impp("c1/a", cycle, 1.0), impp("c1/b", cycle, 2.0)


def used(sent: dict[Port[Message], Message]) -> tuple[str, tuple[str, ...]]:
    """What a stage was given, and what its message says is missing."""
    notice = at(sent, SENT)
    return notice.text, notice.missing


def test_a_stage_closes_as_soon_as_every_awaited_input_is_of_its_cycle() -> None:
    clerk = AtWork(ON_THE_CLOCK, Clerk())
    a, b = both(0)
    assert clerk.hear(a) == {}
    assert used(clerk.hear(b)) == ("c1/a/impp@0 c1/b/impp@0", ())
    assert clerk.loop.cycle == 1


def test_at_its_deadline_it_takes_the_newest_there_is_and_names_its_cycle() -> None:
    clerk = AtWork(ON_THE_CLOCK, Clerk())
    clerk.hear(*both(0))
    clerk.hear(both(1)[0])
    found = used(clerk.at_deadline("report"))
    assert found == ("c1/a/impp@1 c1/b/impp@0", ("c1/b/impp@0",))
    assert (clerk.loop.missing_inputs, clerk.loop.old_inputs) == (1, 1)


def test_what_is_older_than_the_hold_is_silent_until_it_comes_again() -> None:
    clerk = AtWork(ON_THE_CLOCK, Clerk())
    clerk.hear(*both(0))
    found = []
    for cycle in range(1, HOLD + 3):
        clerk.hear(both(cycle)[0])
        found.append(used(clerk.at_deadline("report"))[1])
    assert found == [("c1/b/impp@0",)] * HOLD + [("c1/b/impp",)] * 2
    assert used(clerk.hear(*both(HOLD + 3)))[1] == ()


def test_a_late_message_counts_where_it_is_the_newest() -> None:
    clerk = AtWork(ON_THE_CLOCK, Clerk())
    clerk.hear(*both(0))
    clerk.hear(both(1)[0])
    clerk.at_deadline("report")
    clerk.hear(both(1)[1], both(2)[0])
    assert used(clerk.at_deadline("report"))[1] == ("c1/b/impp@1",)
    assert clerk.loop.dropped == {}


def test_one_that_is_older_than_the_newest_is_dropped_and_counted() -> None:
    clerk = AtWork(ON_THE_CLOCK, Clerk())
    clerk.hear(*both(0))
    a, b = both(2)
    clerk.at_deadline("report")
    clerk.hear(b, both(1)[1], a)
    assert clerk.loop.dropped == {("c1/b/impp", "late"): 1}


def test_a_second_message_of_a_cycle_is_dropped_and_counted() -> None:
    clerk = AtWork(LOCKSTEP, Clerk())
    a, b = both(0)
    clerk.hear(a, impp("c1/a", 0, 50.0))
    clerk.hear(both(1)[0], both(1)[0])
    assert clerk.loop.dropped == {("c1/a/impp", "duplicate"): 2}
    assert used(clerk.hear(b))[1] == ()


def test_in_lockstep_a_child_may_run_ahead_of_its_parent() -> None:
    clerk = AtWork(LOCKSTEP, Clerk())
    for cycle in range(TURN + 1):
        assert clerk.hear(both(cycle)[0]) == {}
    for cycle in range(TURN + 1):
        assert used(clerk.hear(both(cycle)[1])) == (f"c1/a/impp@{cycle} c1/b/impp@{cycle}", ())
    assert clerk.loop.dropped == {}


def test_a_message_too_far_ahead_is_dropped_and_counted() -> None:
    clerk = AtWork(LOCKSTEP, Clerk())
    clerk.hear(impp("c1/a", 10**9, 1.0))
    assert clerk.loop.dropped == {("c1/a/impp", "other_cycle"): 1}


@pytest.mark.parametrize("power_kw", [math.nan, math.inf, -1.0, 100.1])
def test_an_absurd_number_is_not_used_and_keeps_nobody_waiting(power_kw: float) -> None:
    clerk = AtWork(LOCKSTEP, Clerk(uses=(SET,)))
    clerk.hear(setpoint("c1", 0, 1.0), *both(0))
    clerk.hear(setpoint("c1", TURN, 2.0 * power_kw))
    for cycle in range(1, TURN):
        clerk.hear(*both(cycle))
    a, _ = both(TURN)
    text, missing = used(clerk.hear(a, impp("c1/b", TURN, power_kw)))
    assert text == f"c1/a/impp@{TURN} c1/b/impp@{TURN - 1} c1/setpoint@0"
    assert missing == (f"c1/b/impp@{TURN - 1}", "c1/setpoint@0")
    assert clerk.loop.dropped == {("c1/b/impp", "absurd"): 1, ("c1/setpoint", "absurd"): 1}
    assert clerk.loop.missing_inputs == 0, "no deadline found it missing"


def test_a_message_in_anothers_name_is_not_used() -> None:
    clerk = AtWork(LOCKSTEP, Clerk())
    port, message = impp("c1/a", 0, 1.0)
    message.source = "c1/b"
    assert clerk.hear((port, message), both(0)[1]) == {}
    assert clerk.loop.dropped == {("c1/a/impp", "foreign"): 1}


def test_between_turns_of_its_sender_a_message_is_as_good_as_new_then_it_is_held() -> None:
    clerk = AtWork(LOCKSTEP, Clerk(awaits=(A,), uses=(SET,)))
    clerk.hear(setpoint("c1", 0, 1.0))
    found = [used(clerk.hear(both(cycle)[0])) for cycle in range(TURN + HOLD + 1)]
    assert [text.partition(" ")[2] for text, _ in found[:-1]] == ["c1/setpoint@0"] * (TURN + HOLD)
    entries = [missing for _, missing in found]
    assert entries == [()] * TURN + [("c1/setpoint@0",)] * HOLD + [("c1/setpoint",)]


def test_a_message_of_a_cycle_that_is_no_turn_of_its_sender_is_dropped() -> None:
    clerk = AtWork(LOCKSTEP, Clerk(awaits=(A,), uses=(SET,)))
    clerk.hear(*[both(cycle)[0] for cycle in range(3)])
    clerk.hear(setpoint("c1", 3, 1.0))
    assert clerk.loop.dropped == {("c1/setpoint", "unexpected"): 1}
    assert used(clerk.hear(both(3)[0]))[1] == ("c1/setpoint",)


# Any order of events ------------------------------------------------------------------------------

MAKE: dict[str, Callable[[int], Delivery]] = {
    "a": lambda cycle: impp("c1/a", cycle, 1.0),
    "b": lambda cycle: impp("c1/b", cycle, 2.0),
    "set": lambda cycle: setpoint("c1", cycle, 3.0),
}
EVENTS = st.lists(
    st.one_of(
        st.none(),  # The deadline passes.
        st.tuples(st.sampled_from(["a", "b", "set"]), st.integers(-2, 4)),
    ),
    max_size=60,
)


@given(EVENTS)
def test_what_a_message_names_as_missing_is_exactly_what_was_not_used(
    events: list[tuple[str, int] | None],
) -> None:
    loop = AtWork(ON_THE_CLOCK, Clerk(awaits=(A, B), uses=(SET,))).loop
    sent: list[Notice] = []
    newest: dict[str, int] = {}
    for event in events:
        if event is None:
            sent += notices(loop.close_stage(0))
        else:
            name, offset = event
            cycle = max(loop.cycle + offset, 0)
            loop.hear(*MAKE[name](cycle - cycle % (TURN if name == "set" else 1)), 0)
        while loop.is_complete:
            sent += notices(loop.close_stage(0))
    assert [notice.cycle for notice in sent] == list(range(len(sent)))
    for notice in sent:
        entries = {entry.key: entry.cycle for entry in map(parse_missing, notice.missing)}
        for text in notice.text.split():
            key, _, given_cycle = text.rpartition("@")
            period = TURN if key == "c1/setpoint" else 1
            due = notice.cycle - notice.cycle % period
            if given_cycle == "-":
                assert entries.pop(key) is None
                continue
            cycle = int(given_cycle)
            assert cycle >= newest.get(key, 0), "an input never goes back"
            newest[key] = cycle
            assert entries.pop(key, due) == cycle <= due
            assert notice.cycle - cycle - period + 1 <= HOLD
        assert entries == {}


def notices(sent: list[Delivery]) -> list[Notice]:
    return [message for _, message in sent if isinstance(message, Notice)]


# Beginning and end --------------------------------------------------------------------------------

ROUND = -5
RUN_START: Delivery = (RUN.of(ROOT), LOCKSTEP.run_message("start", 0, 0))


def armed(plan: RunPlan) -> AgentLoop[int]:
    """A clerk that has been through an arming round."""
    loop = AgentLoop(Clerk(uses=(WISH,)), plan)
    for port, message in (dispatch(ROUND, 1.0, 200.0), *both(ROUND), *both(ROUND)):
        loop.hear(port, message, 0)
    assert loop.is_complete
    loop.close_stage(0)
    return loop


@pytest.mark.parametrize("run_plan", [LOCKSTEP, ON_THE_CLOCK])
def test_arming_rounds_leave_no_trace(run_plan: RunPlan) -> None:
    loop = armed(run_plan)
    loop.hear(*RUN_START, 0)
    # What is left of them on its way is not used either.
    for round_ in (-2, -1, -1, -2):
        for port, message in both(round_):
            loop.hear(port, message, 0)
    assert not loop.is_complete
    (_, notice), *_ = loop.close_stage(0)
    assert isinstance(notice, Notice)
    assert (notice.cycle, notice.count) == (0, 1), "its state is the initial one"
    assert notice.missing == ("c1/a/impp", "c1/b/impp", "dispatch")
    assert loop.dropped == {}


def test_messages_of_an_arming_round_may_overtake_its_dispatch() -> None:
    loop = AgentLoop(Clerk(), LOCKSTEP)
    for delivery in (*both(ROUND), *both(ROUND + 1), dispatch(ROUND + 1, 1.0, 200.0)):
        loop.hear(*delivery, 0)
    assert (loop.cycle, loop.is_complete) == (ROUND + 1, True)


def test_messages_of_cycle_0_may_overtake_the_beginning_of_the_run() -> None:
    loop = armed(LOCKSTEP)
    for delivery in both(0):
        loop.hear(*delivery, 0)
    assert not loop.is_complete
    loop.hear(*RUN_START, 0)
    assert (loop.cycle, loop.is_complete) == (0, True)


def test_one_that_has_just_joined_leaves_its_standby_a_cycle_to_speak_first() -> None:
    loop = AgentLoop(Clerk(), plan(cycle_wall_ns=REAL_TIME, standby=("c1",)))
    loop.hear(*dispatch(20, 1.0, 200.0), 0)
    spoke = {}
    for cycle in (20, 21, 22):
        for port, message in both(cycle):
            loop.hear(port, message, 0)
        assert loop.deadline_ns is not None
        loop.close_stage(loop.deadline_ns)
        spoke[cycle] = not loop.silent
    assert spoke == {20: False, 21: False, 22: True}


def test_whoever_wakes_late_goes_to_the_cycle_under_way() -> None:
    clerk = AtWork(ON_THE_CLOCK, Clerk())
    clerk.hear(*both(0))
    assert clerk.loop.catch_up(33 * REAL_TIME + 5)
    assert (clerk.loop.cycle, clerk.loop.skipped_cycles) == (33, 32)
    assert used(clerk.hear(*both(33)))[1] == ()
    assert not clerk.loop.catch_up(33 * REAL_TIME + 9), "the next cycle has not begun yet"


@pytest.mark.parametrize(
    ("run_plan", "may_skip"), [(ON_THE_CLOCK, False), (LOCKSTEP, True)], ids=["plant", "lockstep"]
)
def test_the_plant_does_not_skip_and_in_lockstep_nobody_does(
    run_plan: RunPlan, may_skip: bool
) -> None:
    clerk = AtWork(run_plan, Clerk(may_skip=may_skip))
    assert not clerk.loop.catch_up(33 * REAL_TIME)
    assert clerk.loop.cycle == 0
