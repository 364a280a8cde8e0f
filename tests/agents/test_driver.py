"""A controller in real time on a bus by hand: it goes by the clock, also after it stood still."""

from __future__ import annotations

from collections import Counter

import pytest
from clock_by_hand import ClockByHand
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import dispatch, report, setpoint

from agents.driver import Driver
from agents.loop import AgentLoop
from agents.plan import START_WITHIN_NS, RunPlan
from agents.team import controller
from bus_schemas.bus import Arrival, Delivery, Outbox
from bus_schemas.messages import Message
from bus_schemas.signals import IMPP, RUN, SETPOINT, Port
from bus_schemas.tree import ROOT

PLAN = plan_of(
    {"c1/a": 100.0, "c1/b": 100.0},
    cycles=1000,
    period_cycles=(60, 10),
    cycle_wall_ns=REAL_TIME,
)


class FedBus:
    """Brings what it is given; where that is nothing it lets the time pass."""

    def __init__(self, clock: ClockByHand) -> None:
        self.sent: list[tuple[Port[Message], Message]] = []
        self.coming: list[Arrival] = []
        self.waits = 0
        self._outbox = Outbox()
        self._clock = clock

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        self._outbox.stamp(port, message, now_ns)
        self.sent.append((port, message))

    def receive(self, until_ns: int | None, wanted: int = 1) -> list[Arrival]:
        self.waits += 1
        if not self.coming:
            assert until_ns is not None, "it would wait for ever"
            self._clock.now_ns = max(self._clock.now_ns, until_ns)
        arrivals, self.coming = self.coming, []
        return arrivals


class ProcessByHand:
    """A controller as its process has it, at the time of a clock by hand."""

    def __init__(self, plan: RunPlan, name: str) -> None:
        self.clock = ClockByHand()
        self.bus = FedBus(self.clock)
        self.loop = AgentLoop(controller(plan, name), plan)
        self.driver = Driver([self.loop], self.bus, self.clock)
        self.start_ns = self.clock.now_ns
        self._plan = plan
        self._name = name

    def begin(self, start_ns: int | None = None) -> None:
        """Let the plant say that the run begins."""
        run = self._plan.run_message("start", 0, self.start_ns if start_ns is None else start_ns)
        self.hear((RUN.of(ROOT), run))

    def hear(self, *deliveries: Delivery) -> None:
        """Let messages come now, and the controller act on them."""
        now_ns = self.clock.now_ns
        self.bus.coming += [Arrival(self._name, *delivery, now_ns) for delivery in deliveries]
        self.driver.turn()

    def run_until(self, cycle: float) -> None:
        """Let time pass up to a point of the run."""
        until_ns = self.start_ns + round(cycle * self._plan.cycle_wall_ns)
        while self.clock.now_ns < until_ns:
            self.driver.turn(longest_ns=until_ns)

    def stand_still_until(self, cycle: float) -> None:
        """Let time pass in which the process does nothing."""
        self.clock.now_ns = self.start_ns + round(cycle * self._plan.cycle_wall_ns)

    def cycles(self, port: Port[Message]) -> list[int]:
        """Cycles of what it sent on a port."""
        return [message.cycle for sent_on, message in self.bus.sent if sent_on is port]


def inputs(cycle: int) -> list[Delivery]:
    """What a supervisor hears in a cycle."""
    found = [dispatch(cycle, 100.0, 200.0)]
    found += report("c1/a", cycle, 80.0, 30.0) + report("c1/b", cycle, 80.0, 30.0)
    return found + ([setpoint("c1", cycle, 100.0)] if cycle % 60 == 0 else [])


def supervisor_in_cycle(cycle: int) -> ProcessByHand:
    """The supervisor, in time through all cycles up to one."""
    supervisor = ProcessByHand(PLAN, "c1")
    supervisor.begin()
    for number in range(cycle):
        supervisor.stand_still_until(number)
        supervisor.hear(*inputs(number))
    supervisor.run_until(cycle)
    return supervisor


def test_each_message_goes_out_once_its_inputs_are_there_without_waiting_for_deadlines() -> None:
    supervisor = supervisor_in_cycle(21)
    assert supervisor.cycles(IMPP.of("c1")) == list(range(21))
    assert supervisor.cycles(SETPOINT.of("c1/a")) == [0, 10, 20]
    for _, message in supervisor.bus.sent:
        assert message.publish_time_ns == supervisor.start_ns + message.cycle * REAL_TIME
        assert message.ready_time_ns == message.publish_time_ns
        assert message.missing == ()


def test_a_stopped_supervisor_goes_to_the_cycle_under_way_without_a_burst() -> None:
    supervisor = supervisor_in_cycle(13)
    before = len(supervisor.bus.sent)
    supervisor.stand_still_until(33.0)
    # What came meanwhile has waited in its queue.
    supervisor.hear(*[delivery for cycle in range(13, 34) for delivery in inputs(cycle)])
    late = supervisor.bus.sent[before:]
    assert Counter((str(port), message.cycle) for port, message in late) == {
        ("c1/impp", 33): 1,
        ("c1/residual", 33): 1,
    }
    assert [message.missing for _, message in late] == [(), ()]
    assert supervisor.loop.skipped_cycles == 20
    assert supervisor.loop.dropped == {}
    supervisor.run_until(34.0)
    for cycle in range(34, 41):
        supervisor.stand_still_until(cycle)
        supervisor.hear(*inputs(cycle))
    assert supervisor.cycles(SETPOINT.of("c1/a")) == [0, 10, 40]


def test_where_nothing_comes_every_stage_closes_at_its_deadline() -> None:
    supervisor = supervisor_in_cycle(3)
    supervisor.run_until(7.0)
    reports = [m for port, m in supervisor.bus.sent if port is IMPP.of("c1") and m.cycle >= 3]
    deadline_ns = PLAN.deadlines.deadline_ns("c1", "report")
    assert [m.cycle for m in reports] == [3, 4, 5, 6]
    for message in reports:
        assert message.publish_time_ns == (
            supervisor.start_ns + message.cycle * REAL_TIME + deadline_ns
        )
        assert message.ready_time_ns == message.publish_time_ns
        assert len(message.missing) == 5


@pytest.mark.parametrize("off_ns", [START_WITHIN_NS + 1, -START_WITHIN_NS - 1])
def test_a_start_by_another_hosts_clock_is_now(off_ns: int) -> None:
    supervisor = ProcessByHand(PLAN, "c1")
    supervisor.begin(supervisor.start_ns + off_ns)
    supervisor.run_until(1.5)
    assert supervisor.cycles(IMPP.of("c1")) == [0, 1]
    assert supervisor.loop.skipped_cycles == 0
