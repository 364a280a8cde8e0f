"""Of each input the newest message and its age: which one a stage uses, and what it says of it."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from memory_use import traced_memory
from msgspec.structs import replace
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import AtWork, at, dispatch, impp, setpoint, telemetry

from agents.agent import Stage, Turn
from agents.inputs import log_drop
from agents.loop import Loop
from agents.plan import RunPlan, changed
from agents.plan_parts import START_WITHIN_NS
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message, Notice, parse_missing
from bus_schemas.signals import DISPATCH, IMPP, NOTICE, RUN, SETPOINT, Port
from bus_schemas.tree import ROOT

AWAITED: tuple[Port[Message], ...] = (IMPP.of("c1/a"), IMPP.of("c1/b"))
USED: tuple[Port[Message], ...] = (SETPOINT.of("c1"), DISPATCH.of(ROOT))
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

    may_skip: bool = True
    name: str = "c1"

    def initial_state(self) -> int:
        return 0

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        return (Stage("report", AWAITED, USED),)

    def step(self, state: int, turn: Turn) -> tuple[int, list[Delivery]]:
        found = {str(port): turn.inputs[port] for port in (*AWAITED, *USED)}
        text = " ".join(f"{key}@{m.cycle}" if m else f"{key}@-" for key, m in found.items())
        return state + 1, [(SENT, Notice(*turn.stamp, text=text, count=state + 1))]


def both(cycle: int) -> tuple[Delivery, Delivery]:
    return impp("c1/a", cycle, 1.0), impp("c1/b", cycle, 2.0)


MAKE: dict[str, Callable[[int, float], Delivery]] = {
    "a": lambda cycle, kw: impp("c1/a", cycle, kw),
    "b": lambda cycle, kw: impp("c1/b", cycle, kw),
    "s": lambda cycle, kw: setpoint("c1", cycle, kw),
}

# Any order of events ------------------------------------------------------------------------------

EVENTS = st.lists(
    st.one_of(
        st.none(),  # The deadline passes.
        st.tuples(st.sampled_from(["a", "b", "s"]), st.integers(-2, 4)),
    ),
    max_size=60,
)


@given(EVENTS)
def test_missing_names_exactly_the_unused_inputs(
    events: list[tuple[str, int] | None],
) -> None:
    loop = AtWork(ON_THE_CLOCK, Clerk()).loop
    sent: list[Notice] = []
    newest: dict[str, int] = {}
    for event in events:
        if event is None:
            sent += notices(loop.close_stage(0, is_overdue=True))
        else:
            name, offset = event
            cycle = max(loop.cycle + offset, 0)
            loop.hear(*MAKE[name](cycle - cycle % (TURN if name == "s" else 1), 1.0), 0)
        while (some := loop.close_stage(0)) is not None:
            sent += notices(some)
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


def notices(sent: list[Delivery] | None) -> list[Notice]:
    return [message for _, message in sent or () if isinstance(message, Notice)]


# Beginning and end --------------------------------------------------------------------------------

ROUND = -5
RUN_START: Delivery = (RUN.of(ROOT), LOCKSTEP.run_message("start", 0, 0))


def armed(plan: RunPlan) -> Loop[int]:
    """A clerk that has been through an arming round."""
    loop = Loop(Clerk(), plan)
    for port, message in (dispatch(ROUND, 1.0, 200.0), *both(ROUND), *both(ROUND)):
        loop.hear(port, message, 0)
    assert loop.close_stage(0) is not None
    return loop


@pytest.mark.parametrize("run_plan", [LOCKSTEP, ON_THE_CLOCK])
def test_arming_rounds_leave_no_trace(run_plan: RunPlan) -> None:
    loop = armed(run_plan)
    loop.hear(*RUN_START, 0)
    # What is left of them on its way is not used either.
    for round_ in (-2, -1, -1, -2):
        for port, message in both(round_):
            loop.hear(port, message, 0)
    assert loop.close_stage(0) is None
    (notice,) = notices(loop.close_stage(0, is_overdue=True))
    assert (notice.cycle, notice.count) == (0, 1), "its state is the initial one"
    assert notice.missing == ("c1/a/impp", "c1/b/impp", "c1/setpoint", "dispatch")
    assert loop.inputs.dropped == {}


def test_messages_of_the_cycle_in_which_one_joins_may_overtake_its_dispatch() -> None:
    loop = Loop(Clerk(), ON_THE_CLOCK)
    for cycle in range(5, 21):
        for delivery in both(cycle):
            loop.hear(*delivery, 0)
    loop.hear(*dispatch(20, 1.0, 200.0), 0)
    assert (loop.cycle, loop.inputs.dropped) == (20, {})
    assert loop.close_stage(0) is not None


def test_whoever_wakes_late_goes_to_the_cycle_under_way() -> None:
    clerk = AtWork(ON_THE_CLOCK, Clerk())
    clerk.hear(*both(0))
    assert clerk.loop.catch_up(33 * REAL_TIME + 5)
    assert (clerk.loop.cycle, clerk.loop.times.skipped_cycles) == (33, 32)
    assert at(clerk.hear(*both(33)), SENT).missing == ("c1/setpoint", "dispatch")
    assert not clerk.loop.catch_up(33 * REAL_TIME + 9), "the next cycle has not begun yet"


@pytest.mark.parametrize(
    ("run_plan", "may_skip", "under_way", "goes_to"),
    [
        (ON_THE_CLOCK, False, HOLD, 0),  # The plant goes through every cycle,
        (ON_THE_CLOCK, False, 90, 90),  # unless its machine was suspended.
        (LOCKSTEP, True, 90, 0),
    ],
)
def test_the_plant_skips_only_after_a_long_stop_and_in_lockstep_nobody_does(
    run_plan: RunPlan, may_skip: bool, under_way: int, goes_to: int
) -> None:
    clerk = AtWork(run_plan, Clerk(may_skip=may_skip))
    clerk.loop.catch_up(under_way * REAL_TIME)
    assert (clerk.loop.cycle, clerk.loop.times.skipped_cycles) == (goes_to, goes_to)


@pytest.mark.parametrize(
    ("sent_cycle", "under_way"),
    [
        (20, 23),  # The dispatch was long on its way;
        (50, 50),  # the plant is far behind, and sends it only now.
    ],
)
def test_an_agent_that_joins_by_an_old_dispatch_begins_with_the_cycle_under_way(
    sent_cycle: int, under_way: int
) -> None:
    loop, start_ns, now_ns = Loop(Clerk(), ON_THE_CLOCK), 7, 7 + under_way * REAL_TIME
    port, message = dispatch(20, 1.0, 200.0)
    message.ready_time_ns = start_ns + 20 * REAL_TIME
    message.publish_time_ns = start_ns + sent_cycle * REAL_TIME
    loop.hear(port, message, now_ns)
    assert (loop.cycle, loop.times.start_ns) == (under_way, start_ns)
    assert loop.incarnation == under_way


@pytest.mark.parametrize(
    ("what", "cause"),
    [
        ({"incarnation": 10**9}, "out_of_range"),
        ({"cycle": 50, "incarnation": 50}, "wrong_cycle"),
        ({"cycle": 100, "incarnation": 50}, "wrong_cycle"),
        ({"cycle": 1, "incarnation": 1, "power_kw": math.nan}, "out_of_range"),
    ],
)
def test_a_message_that_is_refused_does_not_shut_out_its_publisher(
    what: dict[str, Any], cause: str
) -> None:
    clerk = AtWork(ON_THE_CLOCK, Clerk())
    clerk.hear(*both(0))
    port, message = impp("c1/a", 1, 1.0)
    clerk.hear((port, replace(message, **what)))
    if what.get("cycle") == 1:
        clerk.at_deadline("report")
    cycle = clerk.loop.cycle
    assert at(clerk.hear(*both(cycle)), SENT).missing == ("c1/setpoint", "dispatch")
    assert {name for _, name in clerk.loop.inputs.dropped} == {cause}


@pytest.mark.parametrize("off_ns", [START_WITHIN_NS + 1, -START_WITHIN_NS - 1])
def test_a_start_by_another_hosts_clock_is_now(off_ns: int) -> None:
    loop, now_ns = armed(ON_THE_CLOCK), 5_000_000_000
    port, run = RUN.of(ROOT), ON_THE_CLOCK.run_message("start", 0, now_ns + off_ns)
    loop.hear(port, run, now_ns)
    deadline_ns = ON_THE_CLOCK.deadlines.deadline_ns("c1", "report")
    assert (loop.cycle, loop.deadline_ns) == (0, now_ns + deadline_ns)


@pytest.mark.parametrize("is_external", [False, True])
def test_one_that_joined_by_a_dispatch_held_back_is_where_the_plant_is(is_external: bool) -> None:
    """An external plant may have another clock: there the dispatch that came fastest counts."""
    run_plan = changed(ON_THE_CLOCK, access={"external": ("plant",) if is_external else ()})
    loop, cycle_ns, late = armed(run_plan), REAL_TIME, 2 * START_WITHIN_NS // REAL_TIME
    start_ns = 10**12

    def hear(cycle: int, heard_in: int) -> int:
        said_ns = start_ns + cycle * cycle_ns
        port, message = dispatch(cycle, 1.0, 200.0)
        stamped = replace(message, ready_time_ns=said_ns, publish_time_ns=said_ns)
        loop.hear(port, stamped, start_ns + heard_in * cycle_ns)
        return loop.cycle

    assert hear(10, 10 + late) == (10 if is_external else 10 + late)
    assert hear(11 + late, 11 + late) == 11 + late or not is_external
    assert loop.times.time_ns(0) == start_ns
    hear(12 + late, 12 + 2 * late)
    assert loop.times.time_ns(0) == start_ns


def test_a_stop_holds_until_the_plant_goes_on() -> None:
    """Any process may send an early stop. It counts only if the plant begins no further cycle."""
    loop = armed(LOCKSTEP)
    loop.hear(*RUN_START, 0)

    def goes_on(cycle: int, *stops: int) -> bool:
        """Whether it closes the stage of a cycle that the plant has begun."""
        stopped = [(RUN.of(ROOT), LOCKSTEP.run_message("stop", stop, 0)) for stop in stops]
        for port, message in (dispatch(cycle, 1.0, 200.0), *both(cycle), *stopped):
            loop.hear(port, message, 0)
        return bool(loop.close_stage(0))

    assert goes_on(0, 0), "a stop before a cycle that has begun"
    assert goes_on(1, 3)
    assert goes_on(2)
    assert loop.finished
    assert goes_on(3)
    assert not loop.times.stop_heard
    assert loop.inputs.dropped == {("run", "conflicting"): 2}


# A flood ------------------------------------------------------------------------------------------


def test_of_each_cycle_to_come_one_message_of_a_key_is_kept() -> None:
    long = plan(period_cycles=(60, 10))
    work = AtWork(long, "c1/a")
    with traced_memory() as memory:
        for number in range(20_000):
            work.loop.hear(*telemetry("c1/a", 1 + number % 61, 1.0), 0)
        assert memory()[0] < 1_000_000
    assert work.loop.inputs.dropped == {("c1/a/telemetry", "duplicate"): 20_000 - 61}


def test_a_flood_of_one_kind_does_not_hide_another_in_the_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    loop = Loop(Clerk(), LOCKSTEP, log_drop)
    loop.begin(0, 0)
    port, message = impp("c1/a", 0, 1.0)
    with caplog.at_level(logging.WARNING):
        for _ in range(10_000):
            loop.hear(port, message, 0)
        loop.hear(port, replace(message, source="central"), 0)
    assert 10 < len(caplog.records) < 40
    assert "is from 'central'" in caplog.records[-1].message
