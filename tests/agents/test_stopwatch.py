"""What a process measures of itself, against times that were worked out by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count

import msgspec
import pytest
from clock_by_hand import ClockByHand
from hdrh.histogram import HdrHistogram

from agents.agent import Stage, Turn
from agents.deadlines import Deadlines
from agents.periods import Periods
from agents.stopwatch import ProcessTiming, Stopwatch, TimedAgent
from bus_schemas.bus import Arrival, Delivery
from bus_schemas.messages import Command, Message, Request, Run, Telemetry
from bus_schemas.signals import COMMAND, REQUEST, RUN, TELEMETRY, Port
from bus_schemas.tree import PLANT, ROOT, ControlTree

MS = 1_000_000
NODE = "c1/inv07"
START = 5_000 * MS
CYCLE = 100 * MS
ASKED, MEASURED = REQUEST.of(NODE), TELEMETRY.of(NODE)
COMMANDS = (COMMAND.of("c1/inv07"), COMMAND.of("c1/inv08"))
TREE = ControlTree(((NODE, 1.0), ("c1/inv08", 1.0)))
DEADLINES = {"begin": 0, "work": 30 * MS, "answer": 60 * MS, "advance": 90 * MS}
SLICES = {"begin": 5 * MS, "work": 10 * MS, "answer": 20 * MS, "advance": 30 * MS}


class DeadlinesByHand(Deadlines):
    """Of stages of our own, whoever's they are."""

    def deadline_ns(self, agent: str, stage: str) -> int:
        return DEADLINES[stage]

    def slice_ns(self, agent: str, stage: str) -> int:
        return SLICES[stage]


@dataclass
class Team:
    """An agent of given stages, and a stopwatch that is driven by hand."""

    stages_: Sequence[Stage]
    name: str = NODE
    clock: ClockByHand = field(default_factory=lambda: ClockByHand(START))
    cycle_ns: int = CYCLE

    def __post_init__(self) -> None:
        deadlines = DeadlinesByHand(TREE, self.cycle_ns)
        self.stopwatch = Stopwatch(self, deadlines, Periods((1, 1)), self.clock)
        self.stopwatch.begin(START)
        self.inputs: dict[Port[Message], Message] = {}

    def initial_state(self) -> None:
        return None

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        return tuple(self.stages_)

    def follow_up(self, port: Port[Message], message: Message) -> None:
        return None

    def step(self, state: None, turn: Turn) -> tuple[None, list[Delivery]]:
        return None, []

    def at(self, cycle: int, into_ms: float) -> int:
        return START + cycle * self.cycle_ns + round(into_ms * MS)

    def hear(self, port: Port[Message], cycle: int, said_ms: float, heard_ms: float) -> None:
        """Let a message arrive, with both times counted from the beginning of its cycle."""
        said_ns = self.at(cycle, said_ms)
        message = a_message(port, cycle, said_ns)
        self.inputs[port] = message
        self.stopwatch.arrived([Arrival(port, message, self.at(cycle, heard_ms))])

    def close(
        self,
        stage: str,
        cycle: int,
        closed_ms: float,
        sent_ms: Sequence[float] = (),
        missing: tuple[str, ...] = (),
    ) -> None:
        turn = Turn(stage, cycle, 0, (cycle, 0, self.name, missing), dict(self.inputs))
        outputs: list[Delivery] = [
            (COMMAND.of(NODE), a_message(COMMAND.of(NODE), cycle, 0)) for _ in sent_ms
        ]
        self.stopwatch.closed(turn, self.at(cycle, closed_ms), outputs)
        for (_, message), moment_ms in zip(outputs, sent_ms, strict=True):
            self.clock.now_ns = self.at(cycle, moment_ms)
            self.stopwatch.handed_over(message)

    def account(self) -> ProcessTiming:
        return self.stopwatch.account(late_used=0)


def a_message(port: Port[Message], cycle: int, said_ns: int) -> Message:
    stamp = (cycle, 0, port.publisher, ())
    if port.signal is REQUEST:
        return Request(*stamp, publish_time_ns=said_ns, power_kw=1.0)
    if port.signal is TELEMETRY:
        return Telemetry(*stamp, publish_time_ns=said_ns, power_kw=1.0, alpha=1.0, limit_kw=1.0)
    return Command(*stamp, publish_time_ns=said_ns, alpha=1.0, power_kw=1.0)


def in_ms(account: ProcessTiming, measure: str) -> list[float]:
    """Return the values of a measure [ms], in order; each to 1 % of itself."""
    histogram = HdrHistogram.decode(account.histograms[measure].encode())
    values: list[float] = []
    for item in histogram.get_recorded_iterator():
        values += [item.value_iterated_to / MS] * item.count_at_value_iterated_to
    return values


def near(*values_ms: float) -> object:
    return pytest.approx(list(values_ms), rel=0.01, abs=0.002)


WORK = Stage("work", frozenset({ASKED, MEASURED}))
ANSWER = Stage("answer", frozenset())


def test_a_decision_counts_from_the_last_input_to_the_last_message() -> None:
    team = Team([WORK])
    team.hear(MEASURED, 0, 1.0, 2.0)
    team.hear(ASKED, 0, 3.0, 7.0)
    team.close("work", 0, 9.0, sent_ms=[10.0, 12.0])
    account = team.account()
    assert in_ms(account, "decision/work") == near(5.0)
    assert in_ms(account, f"hop/{NODE}/telemetry") == near(1.0)
    assert in_ms(account, f"hop/{NODE}/request") == near(4.0)
    assert in_ms(account, "age/work") == near(8.0)
    assert "lateness/work" not in account.histograms
    assert account.missed_deadlines == account.overruns == {}


def test_least_and_greatest_are_kept_exactly_beside_the_histogram() -> None:
    team = Team([WORK])
    for cycle, took_ms in enumerate((5.017, 7.033, 6.0)):
        team.hear(MEASURED, cycle, 1.0, 2.0)
        team.hear(ASKED, cycle, 3.0, 4.0)
        team.close("work", cycle, 4.5, sent_ms=[4.0 + took_ms])
    account = msgspec.json.decode(msgspec.json.encode(team.account()), type=ProcessTiming)
    assert account.extremes["decision/work"] == (5_017_000, 7_033_000)
    assert account.extremes.keys() == account.histograms.keys()


def test_a_stage_without_inputs_can_close_once_the_one_before_it_has_spoken() -> None:
    team = Team([WORK, ANSWER])
    team.hear(MEASURED, 0, 1.0, 2.0)
    team.hear(ASKED, 0, 1.0, 2.0)
    # Both close in one go, before anything is sent.
    outputs = [a_message(COMMANDS[0], 0, 0) for _ in range(3)]
    for stage, closed_ms, own in (("work", 3.0, outputs[:2]), ("answer", 4.0, outputs[2:])):
        turn = Turn(stage, 0, 0, (0, 0, NODE, ()), dict(team.inputs))
        said: list[Delivery] = [(COMMANDS[0], message) for message in own]
        team.stopwatch.closed(turn, team.at(0, closed_ms), said)
    for message, moment_ms in zip(outputs, (5.0, 6.0, 8.0), strict=True):
        team.clock.now_ns = team.at(0, moment_ms)
        team.stopwatch.handed_over(message)
    account = team.account()
    assert in_ms(account, "decision/work") == near(4.0)
    assert in_ms(account, "decision/answer") == near(2.0)


def test_at_a_deadline_the_decision_counts_from_the_deadline_and_the_absent_are_named() -> None:
    team = Team([WORK])
    team.hear(MEASURED, 0, 1.0, 2.0)
    team.close("work", 0, 31.0, sent_ms=[33.0], missing=(f"{NODE}/request",))
    account = team.account()
    assert in_ms(account, "decision/work") == near(3.0)
    assert in_ms(account, "lateness/work") == near(1.0)
    assert account.missed_deadlines == {"work": 1}
    assert account.missing_inputs == {f"{NODE}/request": 1}
    assert account.overruns == {}


def test_a_late_word_counts_as_missing_and_its_age_as_used() -> None:
    team = Team([WORK])
    team.hear(MEASURED, 1, 1.0, 2.0)
    team.inputs[ASKED] = a_message(ASKED, 0, team.at(0, 5.0))
    team.close("work", 1, 30.0, sent_ms=[31.0], missing=(f"{NODE}/request@0",))
    account = team.account()
    assert account.missing_inputs == {f"{NODE}/request": 1}
    assert in_ms(account, "age/work") == near(125.0)


def test_a_late_word_that_nothing_waited_for_is_no_missed_deadline() -> None:
    team = Team([Stage("work", frozenset({MEASURED}), takes_late=frozenset({ASKED}))])
    team.hear(MEASURED, 1, 1.0, 2.0)
    team.close("work", 1, 3.0, sent_ms=[4.0], missing=(f"{NODE}/request@0",))
    account = team.account()
    assert account.missed_deadlines == account.missing_inputs == {}
    assert in_ms(account, "decision/work") == near(2.0)


def test_each_stage_is_charged_with_what_it_lacked_itself() -> None:
    second = Stage("answer", frozenset({COMMANDS[1]}))
    team = Team([WORK, second])
    lacked = (f"{NODE}/request", f"{NODE}/telemetry")
    team.close("work", 0, 30.0, missing=lacked)
    team.hear(COMMANDS[1], 0, 40.0, 41.0)
    team.close("answer", 0, 42.0, sent_ms=[43.0], missing=lacked)
    account = team.account()
    assert account.missed_deadlines == {"work": 1}
    assert in_ms(account, "decision/answer") == near(2.0)


def test_a_complete_stage_that_closes_after_its_deadline_is_an_overrun() -> None:
    team = Team([WORK])
    team.hear(MEASURED, 0, 1.0, 2.0)
    team.hear(ASKED, 0, 1.0, 2.0)
    team.close("work", 0, 30.5, sent_ms=[31.0])
    assert team.account().overruns == {"work": 1}


@pytest.mark.parametrize(("closed_ms", "overruns"), [(39.0, {}), (41.0, {"work": 1})])
def test_a_stage_closed_by_its_deadline_has_a_slice_of_grace(
    closed_ms: float, overruns: dict[str, int]
) -> None:
    team = Team([WORK])
    team.close("work", 0, closed_ms, missing=(f"{NODE}/request", f"{NODE}/telemetry"))
    assert team.account().overruns == overruns


def test_each_stage_has_its_own_grace() -> None:
    advance = Stage("advance", frozenset({COMMANDS[0]}))
    team = Team([WORK, advance])
    lacked = (f"{NODE}/request", f"{NODE}/telemetry")
    team.close("work", 0, 45.0, missing=lacked)
    team.close("advance", 0, 105.0, missing=(*lacked, "c1/inv07/command"))
    assert team.account().overruns == {"work": 1}


def test_an_input_that_came_after_the_deadline_misses_it_though_it_was_used() -> None:
    """It came 20 us after the deadline, and 30 us before the process woke."""
    team = Team([WORK])
    team.hear(MEASURED, 0, 1.0, 2.0)
    team.hear(ASKED, 0, 29.9, 30.02)
    team.close("work", 0, 30.05, sent_ms=[31.0])
    account = team.account()
    assert account.missed_deadlines == {"work": 1}
    assert account.missing_inputs == {f"{NODE}/request": 1}
    assert account.overruns == {}
    assert in_ms(account, "decision/work") == near(1.0)
    assert in_ms(account, "lateness/work") == near(0.05)


def test_an_input_that_came_in_time_is_not_missing_though_the_process_did_not_look() -> None:
    team = Team([WORK])
    team.hear(MEASURED, 0, 1.0, 2.0)
    team.hear(ASKED, 0, 1.0, 29.9)
    team.close("work", 0, 30.5, sent_ms=[31.0], missing=(f"{NODE}/request",))
    account = team.account()
    assert account.missed_deadlines == account.missing_inputs == {}
    assert account.overruns == {"work": 1}
    assert in_ms(account, "decision/work") == near(1.1)


def test_cycles_that_were_given_up_are_overruns_and_nobody_is_blamed_for_them() -> None:
    team = Team([WORK])
    words = ("skipped@0", f"{NODE}/request", f"{NODE}/telemetry")
    turn = Turn("work", 0, 0, (0, 0, NODE, words), {})
    unsent: list[Delivery] = [(COMMANDS[0], a_message(COMMANDS[0], 0, 0))]
    team.stopwatch.closed(turn, team.at(2, 1.0), unsent)
    team.hear(MEASURED, 2, 1.0, 2.0)
    team.hear(ASKED, 2, 1.0, 2.0)
    team.close("work", 2, 3.0, sent_ms=[4.0], missing=("skipped@0",))
    account = team.account()
    assert account.overruns == {"work": 1}
    assert account.missed_deadlines == account.missing_inputs == {}
    # Its words of cycle 0 were due at 30 ms, and at 201 ms it knew that there would be none.
    assert in_ms(account, "decision/work") == near(2.0, 171.0)
    assert in_ms(account, "lateness/work") == near(171.0)


def test_a_process_that_stood_still_has_a_decision_for_each_cycle_that_it_gave_up() -> None:
    """Coordinated omission: it stood for 9 of 20 cycles, so the median is not that of the rest."""
    team = Team([WORK])
    words = (f"{NODE}/request", f"{NODE}/telemetry")
    woke_ms = 14 * 100.0 + 1.0
    for cycle in range(20):
        if 5 <= cycle < 14:
            stamp = (cycle, 0, NODE, (f"skipped@{cycle}", *words))
            turn = Turn("work", cycle, 0, stamp, {})
            team.stopwatch.closed(turn, START + round(woke_ms * MS), [])
            continue
        team.hear(MEASURED, cycle, 1.0, 2.0)
        team.hear(ASKED, cycle, 1.0, 2.0)
        team.close("work", cycle, 3.0, sent_ms=[3.0])
    decisions_ms = in_ms(team.account(), "decision/work")
    assert decisions_ms == near(*[1.0] * 11, *(71.0 + 100.0 * late for late in range(9)))
    assert team.stopwatch.slowest_decision_ns == 871 * MS


def test_jitter_is_how_far_two_closings_are_from_whole_cycles_apart() -> None:
    team = Team([WORK])
    for cycle, closed_ms in ((0, 5.0), (1, 8.0), (3, 7.0)):
        team.hear(MEASURED, cycle, 1.0, 2.0)
        team.hear(ASKED, cycle, 1.0, 2.0)
        team.close("work", cycle, closed_ms)
    assert in_ms(team.account(), "jitter/work") == near(1.0, 3.0)


def test_held_inputs_have_their_age() -> None:
    asks_twice = Team([WORK])
    asks_twice.hear(MEASURED, 0, 1.0, 2.0)
    asks_twice.hear(ASKED, 0, 1.0, 2.0)
    asks_twice.close("work", 0, 3.0)
    # Between its parent's turns the agent goes by the last request.
    asks_twice.stages_ = [Stage("work", frozenset({MEASURED}))]
    del asks_twice.inputs[ASKED]
    asks_twice.hear(MEASURED, 1, 1.0, 2.0)
    asks_twice.close("work", 1, 3.0)
    assert in_ms(asks_twice.account(), "age/work") == near(2.0, 102.0)


def test_the_plants_loop_counts_from_the_scheduled_tick() -> None:
    begin = Stage("begin", frozenset(), timed=True)
    plant = Team([begin, Stage("advance", frozenset(COMMANDS))], name=PLANT)
    plant.close("begin", 0, 4.0, sent_ms=[5.0])
    for port, heard_ms in zip(COMMANDS, (12.0, 20.0), strict=True):
        plant.hear(port, 0, 11.0, heard_ms)
    plant.close("advance", 0, 21.0)
    # The second command does not come in the next cycle.
    plant.close("begin", 1, 1.0, sent_ms=[2.0])
    plant.inputs.clear()
    plant.hear(COMMANDS[0], 1, 11.0, 12.0)
    plant.close("advance", 1, 90.5, missing=("c1/inv08/command",))
    account = plant.account()
    assert in_ms(account, "lateness/begin") == near(1.0, 4.0)
    assert in_ms(account, "decision/begin") == near(2.0, 5.0)
    assert in_ms(account, "loop") == near(21.0, 90.5)
    assert in_ms(account, "loop/c1/inv07") == near(12.0, 12.0)
    assert in_ms(account, "loop/c1/inv08") == near(20.0, 90.5)


def test_one_stall_counts_for_all_the_cycles_that_it_delayed() -> None:
    """A stall of 200 ms at cycles of 1 ms: 190 ms at the 99th percentile, not 50 us."""
    fast = Team([Stage("work", frozenset({MEASURED}))], cycle_ns=MS)
    stall_began_ms, stall_ms = 500, 200
    now_ms = 0.0
    for cycle in range(1000):
        fast.hear(MEASURED, cycle, 0.0, 0.01)
        begins_ms = max(now_ms, cycle + 0.01)
        if stall_began_ms <= begins_ms < stall_began_ms + stall_ms:
            begins_ms = stall_began_ms + stall_ms
        # Once it is awake again it needs 0.05 ms for each cycle that waits.
        now_ms = begins_ms + 0.05
        fast.close("work", cycle, begins_ms - cycle, sent_ms=[now_ms - cycle])
    decisions_ms = in_ms(fast.account(), "decision/work")
    assert len(decisions_ms) == 1000
    assert decisions_ms[500] == pytest.approx(0.05, abs=0.01)
    # The tenth largest: nine cycles later the clock is 9 ms on, and 9 x 0.05 ms of work are done.
    assert decisions_ms[989] == pytest.approx(200.0 - 10.0 * 0.95, rel=0.01)


def test_arming_rounds_and_words_about_the_run_do_not_count() -> None:
    team = Team([WORK])
    team.hear(MEASURED, -1, 1.0, 2.0)
    team.close("work", -1, 3.0, sent_ms=[4.0])
    run = Run(0, 0, PLANT, (), 1, 0, state="start", start_time_ns=START, cycle_wall_ns=CYCLE)
    team.stopwatch.arrived([Arrival(RUN.of(ROOT), run, START)])
    assert team.account().histograms == {}


def test_messages_of_a_stranger_or_without_a_time_have_no_hop() -> None:
    team = Team([WORK])
    false = Telemetry(0, 0, "c1", (), team.at(0, 1.0), power_kw=1.0, alpha=1.0, limit_kw=1.0)
    team.stopwatch.arrived([Arrival(MEASURED, false, team.at(0, 2.0))])
    untimed = a_message(MEASURED, 0, 0)
    team.stopwatch.arrived([Arrival(MEASURED, untimed, team.at(0, 2.0))])
    of_another_clock = a_message(MEASURED, 0, team.at(9, 1.0))
    team.stopwatch.arrived([Arrival(MEASURED, of_another_clock, team.at(0, 2.0))])
    assert team.account().histograms == {}


@pytest.mark.parametrize(("said_ms", "is_measured"), [(0.5 - 100.0, True), (-100.5, False)])
def test_what_claims_to_be_from_before_the_last_cycle_is_of_another_clock(
    said_ms: float, is_measured: bool
) -> None:
    team = Team([WORK])
    team.hear(MEASURED, 3, said_ms, 2.0)
    team.hear(ASKED, 3, 1.0, 2.0)
    team.close("work", 3, 3.0)
    account = team.account()
    assert (f"hop/{NODE}/telemetry" in account.histograms) is is_measured
    assert in_ms(account, "age/work") == near(3.0 - said_ms if is_measured else 2.0)


def test_what_is_noted_does_not_pile_up() -> None:
    team = Team([WORK])
    for cycle in range(6_000):
        team.hear(MEASURED, cycle, 1.0, 2.0)
    team.stopwatch.make_room()
    assert team.stopwatch.noted == 5_000
    assert team.stopwatch.settle()
    assert team.stopwatch.noted == 0
    # Of cycles that it gives up it hears and says nothing.
    for cycle in range(6_000):
        team.close("work", cycle, 3.0)
    team.stopwatch.make_room()
    assert team.stopwatch.noted == 5_000


def test_settled_bit_by_bit_it_comes_to_the_same() -> None:
    accounts = []
    for bits in (1, 7, 10_000):
        team = Team([WORK, ANSWER])
        for cycle in range(40):
            team.hear(MEASURED, cycle, 1.0, 2.0)
            if cycle % 3:
                team.hear(ASKED, cycle, 3.0, 4.0 + cycle)
            late = () if cycle % 3 else (f"{NODE}/request",)
            team.close("work", cycle, 45.0, sent_ms=[46.0, 47.0], missing=late)
            team.close("answer", cycle, 48.0, sent_ms=[49.0], missing=late)
            if cycle % 10 == 9:
                settle_by(team, bits)
        accounts.append(team.account())
    first, *others = accounts
    for other in others:
        assert other.histograms == first.histograms
        assert other.missed_deadlines == first.missed_deadlines == {"work": 22}
        assert other.overruns == first.overruns != {}


def settle_by(team: Team, bits: int) -> None:
    """Settle so many moments at a time, by a clock that goes on with each look at it."""
    is_settled = False
    while not is_settled:
        looks = count(1)
        team.stopwatch._now_ns = looks.__next__
        noted = team.stopwatch.noted
        is_settled = team.stopwatch.settle(until_ns=bits + 1)
        # A closing takes along what was handed over with it.
        assert bits <= noted - team.stopwatch.noted <= 3 * bits or is_settled
    team.stopwatch._now_ns = team.clock


def test_the_message_has_the_sums_and_the_slowest_decision() -> None:
    team = Team([WORK])
    for cycle in (0, 1):
        team.close(
            "work",
            cycle,
            45.0,
            sent_ms=[50.0 + cycle],
            missing=(f"{NODE}/request", f"{NODE}/telemetry"),
        )
    team.stopwatch.settle()
    message = team.stopwatch.message((1, 0, NODE, ()), late_used=3, dropped=4)
    assert message.counts == (2, 4, 3, 2, 4)
    assert message.slowest_decision_ns == 21 * MS
    assert team.stopwatch.last_cycle == 1


def test_a_timed_agent_decides_as_the_agent_itself_and_is_noted() -> None:
    team = Team([WORK])
    timed = TimedAgent(team, team.stopwatch, team.clock)
    turn = Turn("work", 0, 0, (0, 0, NODE, ()), {})
    assert timed.name == NODE
    assert timed.stages(0) == team.stages(0)
    assert timed.step(None, turn) == team.step(None, turn)
    assert "jitter/work" not in team.account().histograms
    team.clock.now_ns = team.at(1, 7.0)
    timed.step(None, Turn("work", 1, 0, (1, 0, NODE, ()), {}))
    assert in_ms(team.account(), "jitter/work") == near(7.0)


def test_the_account_says_what_the_process_took() -> None:
    team = Team([WORK])
    sum(number * number for number in range(2_000_000))
    team.clock.now_ns = START + 3_000 * MS
    account = team.account()
    assert account.agent == NODE
    assert account.wall_s == pytest.approx(3.0)
    assert account.cpu_s > 0.0
    assert 10.0 < account.resident_mb < 10_000.0
