"""What a real-time process measures of itself: when it heard, closed a stage, and had answered.

While a cycle runs, the stopwatch only notes moments. What they mean is worked out between the
cycles, when nobody waits for this process (`settle`). All is measured from SCHEDULED times, so that
a stall counts in every cycle that it delayed.
"""

from __future__ import annotations

import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from typing import Final, Generic, NamedTuple, TypeVar

import msgspec

from agents.agent import Agent, Stage, Turn
from agents.deadlines import Deadlines
from agents.histograms import Extremes, Histograms
from agents.machine import resources_used, scheduling_policy
from agents.periods import Periods
from bus_schemas.bus import Arrival, Delivery
from bus_schemas.messages import Message, Stamp, Timing
from bus_schemas.missing import SKIPPED, Absence, absence
from bus_schemas.signals import Port
from bus_schemas.tree import PLANT

S = TypeVar("S")

_MOST_NOTED: Final = 5_000
"""Moments that are noted at most: what comes in beyond is paid for at once, one for one."""

_NEVER_NS: Final = sys.maxsize


class ProcessTiming(msgspec.Struct, frozen=True):
    """What a process measured of itself in a run in real time, from cycle 0 on.

    Attributes
    ----------
    agent
        Name of the agent.
    histograms
        For each measure an HdrHistogram of nanoseconds (1 us to 1 h, two significant figures),
        encoded as text. `decision/STAGE`: from the moment at which the stage could close to its
        last message handed to the bus; of one that was given up, from its deadline to that moment.
        `hop/PORT`: from publishing to arrival. `lateness/STAGE`: how long after its scheduled time
        a stage closed that the clock drives. `jitter/STAGE`: by how much the time between two
        closings differs from the cycles between them. `age/STAGE`: age of the oldest input that a
        decision used. At the plant `loop` and `loop/INVERTER`: from the scheduled tick to the
        applied commands.
    missed_deadlines
        By stage: how often its deadline passed before all its inputs had arrived.
    missing_inputs
        By port: how often its message had not arrived by the deadline.
    overruns
        By stage: how often the process itself was late. All inputs had come by the deadline, and
        it closed after it; or they had not, and it closed later than its deadline by more than its
        slice of the cycle; or it was given up.
    late_used
        How often a message of an earlier cycle was used in place of an absent one.
    cpu_s, wall_s
        Processor time of all threads, and wall time that it took.
    switches_voluntary, switches_involuntary
        How often it gave the processor up, and how often it was taken from it.
    resident_mb
        Most memory that was resident [MB of 1,000,000 bytes].
    policy
        Scheduling policy and processors as they really are: `fifo 20 on CPU 0, 1`.
    extremes
        For each measure the least and the greatest duration, exactly [ns].
    """

    agent: str
    histograms: dict[str, str]
    missed_deadlines: dict[str, int]
    missing_inputs: dict[str, int]
    overruns: dict[str, int]
    late_used: int
    cpu_s: float
    wall_s: float
    switches_voluntary: int
    switches_involuntary: int
    resident_mb: float
    policy: str
    extremes: dict[str, Extremes] = {}


class Closing(NamedTuple):
    """A stage that closed: what the agent saw, when, and what it answered."""

    turn: Turn
    time_ns: int
    outputs: list[Delivery]


class Notes:
    """Moments that were noted, and have still to be settled."""

    def __init__(self) -> None:
        self.arrivals: deque[Arrival] = deque()
        self.closings: deque[Closing] = deque()
        self.handed: deque[tuple[Message, int]] = deque()

    def __len__(self) -> int:
        return len(self.arrivals) + len(self.closings) + len(self.handed)


class Stopwatch:
    """Measures one agent of a run in real time.

    Parameters
    ----------
    agent
        The agent.
    deadlines, periods
        Of the run.
    now_ns
        The clock: monotonic nanoseconds.
    """

    def __init__(
        self,
        agent: Agent[S],
        deadlines: Deadlines,
        periods: Periods,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.missed_deadlines: Counter[str] = Counter()
        self.missing_inputs: Counter[str] = Counter()
        self.overruns: Counter[str] = Counter()
        self.slowest_decision_ns = 0
        self.last_cycle = 0
        self._name = agent.name
        self._stages = agent.stages
        self._deadlines = deadlines
        self._longest_period = periods.longest
        self._now_ns = now_ns
        self._start_ns = 0
        self._used_at_start = resources_used()
        self._notes = Notes()
        self._being_settled = Notes()
        self._histograms = Histograms()
        self._came_ns: dict[int, dict[Port[Message], int]] = {}
        self._published_ns: dict[Port[Message], int] = {}
        self._inputs = _inputs_by_stage(
            stage for cycle in range(periods.longest) for stage in agent.stages(cycle)
        )
        self._closed: dict[str, tuple[int, int]] = {}
        self._cycle = -1
        self._absent = 0
        self._answered_ns = 0

    def begin(self, start_time_ns: int) -> None:
        """Let cycle 0 begin at a time of the clock: before it nothing counts."""
        self._start_ns = start_time_ns
        self._used_at_start = resources_used()

    def arrived(self, arrivals: list[Arrival]) -> None:
        """Note what has come in."""
        self._notes.arrivals.extend(arrivals)

    def closed(self, turn: Turn, time_ns: int, outputs: list[Delivery]) -> None:
        """Note that a stage closed at a time, and what came of it."""
        self._notes.closings.append(Closing(turn, time_ns, outputs))

    def handed_over(self, message: Message) -> None:
        """Note that one of these messages has been handed to the bus."""
        self._notes.handed.append((message, self._now_ns()))

    @property
    def noted(self) -> int:
        """How many moments are noted and not settled."""
        return len(self._notes) + len(self._being_settled)

    def settle(self, until_ns: int | None = None) -> bool:
        """Work out what the noted moments mean. For when nobody waits for this process.

        Parameters
        ----------
        until_ns
            When to leave off; the rest is for the next time. None: once all is settled.

        Returns
        -------
        bool
            Whether all is settled.
        """
        while self.noted:
            if until_ns is not None and self._now_ns() >= until_ns:
                return False
            self._settle_one()
        return True

    def make_room(self) -> None:
        """Settle what is noted beyond 5,000 moments, whoever may be waiting for this process.

        So each turn of the loop settles as many as it brings at most, and none has to settle all.
        """
        while self.noted > _MOST_NOTED:
            self._settle_one()

    def message(self, stamp: Stamp, late_used: int, dropped: int) -> Timing:
        """Return what is counted up to now as a message."""
        return Timing(
            *stamp,
            missed_deadlines=self.missed_deadlines.total(),
            missing_inputs=self.missing_inputs.total(),
            late_used=late_used,
            overruns=self.overruns.total(),
            dropped=dropped,
            slowest_decision_ns=self.slowest_decision_ns,
        )

    def account(self, late_used: int) -> ProcessTiming:
        """Return what was measured up to now."""
        self.settle()
        used, before = resources_used(), self._used_at_start
        return ProcessTiming(
            agent=self._name,
            histograms=self._histograms.encoded(),
            missed_deadlines=dict(self.missed_deadlines),
            missing_inputs=dict(self.missing_inputs),
            overruns=dict(self.overruns),
            late_used=late_used,
            cpu_s=used.cpu_s - before.cpu_s,
            wall_s=(self._now_ns() - self._start_ns) / 1e9,
            switches_voluntary=used.switches_voluntary - before.switches_voluntary,
            switches_involuntary=used.switches_involuntary - before.switches_involuntary,
            resident_mb=used.resident_mb,
            policy=scheduling_policy(),
            extremes=self._histograms.extremes(),
        )

    def _settle_one(self) -> None:
        """Settle an arrival, or a closing with what was handed over then.

        All arrivals that had been noted by then go before closings: a message may have come in time
        for a stage that closed without it.
        """
        if not self._being_settled:
            self._notes, self._being_settled = self._being_settled, self._notes
        notes = self._being_settled
        if notes.arrivals:
            self._settle_arrival(notes.arrivals.popleft())
        elif notes.closings:
            closing = notes.closings.popleft()
            handed_ns = _handed_ns(closing, notes.handed)
            if closing.turn.cycle >= 0:
                self._settle_closing(closing, handed_ns)
        else:
            notes.handed.clear()
        if not notes:
            self._forget_cycles()

    def _settle_arrival(self, arrival: Arrival) -> None:
        port, message, time_ns = arrival
        genuine = message.source == port.publisher
        if not genuine or message.cycle < 0 or not port.signal.is_cyclic:
            return
        self._came_ns.setdefault(message.cycle, {}).setdefault(port, time_ns)
        if self._is_possible(message) and message.publish_time_ns <= time_ns:
            self._histograms.record(f"hop/{port}", time_ns - message.publish_time_ns)

    def _is_possible(self, message: Message) -> bool:
        """Whether a message may have been published when it says.

        A device that does not say so names 0, one with another clock a time that may lie hours
        back: nothing of a cycle is published before the tick of the cycle before it.
        """
        return message.publish_time_ns >= max(self._tick_ns(message.cycle - 1), 1)

    def _settle_closing(self, closing: Closing, handed_ns: int | None) -> None:
        turn, time_ns, _ = closing
        if turn.cycle != self._cycle:
            self._cycle, self.last_cycle, self._absent = turn.cycle, turn.cycle, 0
            self._answered_ns = 0
        stage = self._stage(turn)
        absent = self._absent_here(turn, stage)
        after_ns = self._deadlines.deadline_ns(self._name, turn.stage)
        deadline_ns = self._tick_ns(turn.cycle) + after_ns
        given_up = str(Absence(SKIPPED, turn.cycle)) in turn.stamp[3]
        missing = () if given_up else self._missing(turn.cycle, stage, absent, deadline_ns)
        by_the_clock = stage.timed or given_up or bool(missing)
        if missing:
            self.missed_deadlines[turn.stage] += 1
            self.missing_inputs.update(map(str, missing))
        grace_ns = self._deadlines.slice_ns(self._name, turn.stage) if by_the_clock else 0
        if given_up or time_ns - deadline_ns > grace_ns:
            self.overruns[turn.stage] += 1
        if by_the_clock:
            self._histograms.record(f"lateness/{turn.stage}", time_ns - deadline_ns)
        self._record_jitter(turn, time_ns)
        self._record_age(turn, time_ns)
        if turn.stage == "advance" and self._name == PLANT:
            self._record_loop(turn, stage, time_ns)
        # Who gave a stage up owed its words all the same, up to the moment at which it did so.
        ended_ns = time_ns if given_up and handed_ns is None else handed_ns
        if ended_ns is not None:
            could_ns = deadline_ns if by_the_clock else self._could_close_ns(turn, stage, time_ns)
            decision_ns = ended_ns - could_ns
            self._histograms.record(f"decision/{turn.stage}", decision_ns)
            self.slowest_decision_ns = max(self.slowest_decision_ns, decision_ns)
            self._answered_ns = ended_ns

    def _stage(self, turn: Turn) -> Stage:
        return next(stage for stage in self._stages(turn.cycle) if stage.name == turn.stage)

    def _tick_ns(self, cycle: int) -> int:
        return self._start_ns + cycle * self._deadlines.cycle_ns

    def _absent_here(self, turn: Turn, stage: Stage) -> frozenset[Port[Message]]:
        """Ports whose messages this stage waited for, and closed without."""
        # The stamp goes on with what the stages before it lacked, and names late words also where
        # nothing was waited for.
        entries = turn.stamp[3][self._absent :]
        self._absent = len(turn.stamp[3])
        if not entries:
            return frozenset()
        absent = {key for key, _ in map(absence, entries)}
        return frozenset(port for port in stage.awaits | stage.on_need if str(port) in absent)

    def _missing(
        self, cycle: int, stage: Stage, absent: frozenset[Port[Message]], deadline_ns: int
    ) -> tuple[Port[Message], ...]:
        """Ports whose messages a stage waited for and that had not arrived by its deadline.

        That is not quite what it closed without. A process that wakes late may find what came after
        the deadline, and use it; or it was busy when a message came in time, and closed without.
        """
        came_ns = self._came_ns.get(cycle, {})
        return tuple(
            port
            for port in stage.awaits | stage.on_need
            if came_ns.get(port, _NEVER_NS if port in absent else 0) > deadline_ns
        )

    def _could_close_ns(self, turn: Turn, stage: Stage, time_ns: int) -> int:
        """When the last input came that a complete stage needed, or the stage before it was done.

        The stage before it counts within a cycle only: a process that lags behind by whole cycles
        is late from the moment that its inputs came.
        """
        came_ns = self._came_ns.get(turn.cycle, {})
        inputs = stage.awaits | stage.on_need
        last_ns = max((came_ns.get(port, 0) for port in inputs), default=0)
        return max(min(last_ns, time_ns), self._answered_ns) or time_ns

    def _record_jitter(self, turn: Turn, time_ns: int) -> None:
        last = self._closed.get(turn.stage)
        self._closed[turn.stage] = (turn.cycle, time_ns)
        if last is not None:
            expected_ns = (turn.cycle - last[0]) * self._deadlines.cycle_ns
            self._histograms.record(f"jitter/{turn.stage}", abs(time_ns - last[1] - expected_ns))

    def _record_age(self, turn: Turn, time_ns: int) -> None:
        """Record the age of the oldest input; of a silent port the last word holds."""
        published_ns, oldest_ns = self._published_ns, sys.maxsize
        for port in self._inputs.get(turn.stage, ()):
            message = turn.inputs.get(port)
            if message is not None:
                possible = self._is_possible(message)
                published_ns[port] = message.publish_time_ns if possible else 0
            oldest_ns = min(oldest_ns, published_ns.get(port) or sys.maxsize)
        if oldest_ns <= time_ns:
            self._histograms.record(f"age/{turn.stage}", time_ns - oldest_ns)

    def _record_loop(self, turn: Turn, stage: Stage, time_ns: int) -> None:
        tick_ns, came_ns = self._tick_ns(turn.cycle), self._came_ns.get(turn.cycle, {})
        self._histograms.record("loop", time_ns - tick_ns)
        for port in stage.awaits:
            applied_ns = min(came_ns.get(port, time_ns), time_ns)
            self._histograms.record(f"loop/{port.node}", applied_ns - tick_ns)

    def _forget_cycles(self) -> None:
        """Forget arrivals of cycles that are over, and of those that nobody can be in yet."""
        first, last = self._cycle, self._cycle + self._longest_period
        for cycle in [cycle for cycle in self._came_ns if not first <= cycle <= last]:
            del self._came_ns[cycle]


class TimedAgent(Generic[S]):
    """An agent that has a stopwatch beside it: each of its steps is noted.

    Parameters
    ----------
    agent
        The agent, which knows nothing of it.
    stopwatch
        Its stopwatch.
    now_ns
        The clock: monotonic nanoseconds.
    """

    def __init__(
        self,
        agent: Agent[S],
        stopwatch: Stopwatch,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.name = agent.name
        self.initial_state = agent.initial_state
        self.stages = agent.stages
        self.follow_up = agent.follow_up
        self._step = agent.step
        self._closed = stopwatch.closed
        self._now_ns = now_ns

    def step(self, state: S, turn: Turn) -> tuple[S, list[Delivery]]:
        """Close a stage, and note when that began and what came of it."""
        time_ns = self._now_ns()
        state, outputs = self._step(state, turn)
        self._closed(turn, time_ns, outputs)
        return state, outputs


def _handed_ns(closing: Closing, handed: deque[tuple[Message, int]]) -> int | None:
    """Take what a stage answered from what was handed over; return when the last of it was."""
    handed_ns = None
    for _, output in closing.outputs:
        # Not all that an agent answers is sent: of cycles that it gave up it is not.
        if handed and handed[0][0] is output:
            _, handed_ns = handed.popleft()
    return handed_ns


def _inputs_by_stage(stages: Iterable[Stage]) -> dict[str, frozenset[Port[Message]]]:
    """Ports that a stage needs in any cycle: in the others it goes by their last word."""
    inputs: dict[str, frozenset[Port[Message]]] = {}
    for stage in stages:
        inputs[stage.name] = inputs.get(stage.name, frozenset()) | stage.awaits
    return inputs
