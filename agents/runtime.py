"""Runs one agent as a process: its sequencer, a bus, the clock, and the line to the launcher."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Final, Generic, TypeVar

from agents.agent import Agent
from agents.drop_log import DropLog
from agents.events import Finished
from agents.garbage import spare_the_collector
from agents.interlude import Interlude
from agents.lifeline import Lifeline
from agents.plan import START_WITHIN_NS, RunPlan
from agents.sequencer import Sequencer
from agents.stall_watch import StallWatch
from agents.stopwatch import ProcessTiming, Stopwatch, TimedAgent
from bus_schemas.bus import Delivery
from bus_schemas.faulty_bus import FaultyBus
from bus_schemas.messages import Message, Run
from bus_schemas.signals import PLANT_TIMING, RUN, TIMING, Port
from bus_schemas.tree import CENTRAL, PLANT, ROOT, agent_name
from bus_schemas.zenoh_bus import ZenohBus

S = TypeVar("S")

log = logging.getLogger(__name__)

_MOST_BEHIND: Final = 2
"""So many cycles behind the clock an agent gives up the whole ones between: nobody needs them."""

_IDLE_S: Final = 0.5
"""How long to wait for a message before looking whether something else has changed."""


class Runtime(Generic[S]):
    """One agent on the bus.

    Parameters
    ----------
    agent
        The agent.
    plan
        Of the run.
    bus
        The agent's place on the bus.
    lifeline
        The line to the launcher.
    drop_log
        Names messages that cannot be used.
    now_ns
        The clock: monotonic nanoseconds.
    """

    def __init__(
        self,
        agent: Agent[S],
        plan: RunPlan,
        bus: ZenohBus,
        lifeline: Lifeline,
        drop_log: DropLog,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.agent = agent
        self.plan = plan
        self.bus = bus
        self.lifeline = lifeline
        self._drop_log = drop_log
        self._now_ns = now_ns
        self._stopwatch = (
            None if plan.lockstep else Stopwatch(agent, plan.deadlines, plan.periods, now_ns)
        )
        self._interlude = None if self._stopwatch is None else self._make_interlude(self._stopwatch)
        self._said: tuple[int, ...] = ()
        self.sequencer = Sequencer(
            agent if self._stopwatch is None else TimedAgent(agent, self._stopwatch, now_ns),
            plan.sim_time_ns,
            lockstep=plan.lockstep,
            horizon=plan.periods.longest,
            on_drop=drop_log,
            late=plan.late,
        )
        self.sequencer.end_before(plan.cycles)
        self._start_heard = False
        self._stop_heard = False
        self._bystanders: dict[Port[Message], Callable[[Message], None]] = {}
        self.listen(RUN.of(ROOT), self._heed)
        self._start_time_ns: int | None = None
        self._deadlines_ns: dict[str, int] = {}

    def run(self, dismissed: threading.Event) -> None:
        """Take the agent through the run, from arming to the plant's word that it is over.

        Where nobody can tell an external plant to end the run, the launcher dismisses the agents.
        """
        watch = self.watch_for_stalls()
        spare_the_collector(interludes=not self.plan.lockstep)
        while not (dismissed.is_set() or (self.sequencer.finished and self._stop_heard)):
            self.turn()
        watch.stop()
        self.report()

    def watch_for_stalls(self) -> StallWatch:
        """Begin to look, in lockstep, whether the agent goes on."""
        return StallWatch(self.plan, self.sequencer, self.bus, self.lifeline)

    def report(self) -> None:
        """Tell the launcher what went out and what could not be used."""
        timing = self._timing()
        self.lifeline.tell(
            Finished(
                published=dict(self.bus.published),
                dropped={cause: count for cause, count in self._dropped().items() if count},
                missing_inputs=self.sequencer.missing_inputs,
                late_used=self.sequencer.late_used,
                skipped_cycles=self.sequencer.skipped_cycles,
                dropped_ports=self._dropped_ports(),
                timing=timing,
                faults=self.bus.tally.as_counts() if isinstance(self.bus, FaultyBus) else {},
            )
        )

    def _timing(self) -> ProcessTiming | None:
        """Publish the last counts, and return all that was measured."""
        if self._stopwatch is None:
            return None
        account = self._stopwatch.account(self.sequencer.late_used)
        self._say_counts(self._stopwatch)
        return account

    def _say_counts(self, stopwatch: Stopwatch) -> None:
        """Publish what this process has counted of itself, if that has changed."""
        cycle, name = stopwatch.last_cycle, self.agent.name
        stamp = (cycle, self.plan.sim_time_ns(cycle), name, ())
        message = stopwatch.message(stamp, self.sequencer.late_used, self._dropped().total())
        if any(message.counts) and message.counts != self._said:
            self._said = message.counts
            port = (
                PLANT_TIMING.of(ROOT)
                if name == PLANT
                else TIMING.of(ROOT if name == CENTRAL else name)
            )
            self.bus.publish(port, message)

    def _dropped(self) -> Counter[str]:
        """Messages that came in and could not be used, by cause."""
        dropped = Counter(vars(self.sequencer.drops))
        dropped["undecodable"] = self.bus.undecodable
        dropped["unknown"] = self.bus.unknown
        dropped["flooded"] = self.bus.flooded.total()
        return dropped

    def _dropped_ports(self) -> dict[str, dict[str, int]]:
        """Return the same by key (without the plant's name) and cause, where a key is known."""
        found = {key: dict(causes) for key, causes in self.sequencer.dropped_ports.items()}
        for key, count in self.bus.flooded.items():
            found.setdefault(key, {})["flooded"] = count
        return found

    def listen(self, port: Port[Message], hear: Callable[[Message], None]) -> None:
        """Let a port's messages go to a function: they are about the run, not for the agent."""
        self._bystanders[port] = hear

    def turn(self, longest_s: float = _IDLE_S) -> None:
        """Wait for messages or the deadline, whichever comes first, and act on them."""
        arrivals = self.bus.receive(self.sequencer.wanted, self._patience_s(longest_s))
        if self._stopwatch is not None:
            self._stopwatch.arrived(arrivals)
        self._catch_up()
        for port, message, _ in arrivals:
            bystander = self._bystanders.get(port)
            if bystander is not None and self.sequencer.is_genuine(port, message):
                bystander(message)
            elif bystander is not None:
                continue
            else:
                self.send(self.sequencer.accept(port, message))
        idle = not arrivals
        if not self.sequencer.finished and self._until_deadline_s() == 0.0:
            self.send(self.sequencer.close_stage())
            idle = False
        if self._interlude is not None and idle:
            self._interlude.consider(self.sequencer.cycle)
        elif self._interlude is not None:
            # Whoever is never idle must not note moments without end.
            self._interlude.make_room()

    def _patience_s(self, longest_s: float) -> float:
        """How long to wait for messages: up to the deadline or the next interlude at most."""
        interlude_s = None
        if self._interlude is not None:
            interlude_s = self._interlude.left_s(self.sequencer.cycle)
        waits_s = (longest_s, self._until_deadline_s(), interlude_s)
        return min(wait_s for wait_s in waits_s if wait_s is not None)

    def _catch_up(self) -> None:
        """Give up cycles that are over, after this process has stood still for a whole one.

        The last of them that is this agent's turn is not given up, though its words come late: the
        next one may be far away.
        """
        if self._start_time_ns is None:
            return
        elapsed_ns = self._now_ns() - self._start_time_ns
        under_way = elapsed_ns // self.plan.cycle_wall_ns
        if self.sequencer.cycle < 0 or under_way - self.sequencer.cycle < _MOST_BEHIND:
            return
        last_turn = self._last_turn(under_way)
        if last_turn != self.sequencer.cycle:
            open_turn_is_over = last_turn < self.sequencer.cycle
            self.send(self.sequencer.catch_up(under_way if open_turn_is_over else last_turn))

    def _last_turn(self, cycle: int) -> int:
        """Return the last cycle up to this one in which the agent acts."""
        for parent in self.plan.tree.parents:
            if agent_name(parent) == self.agent.name:
                return self.plan.periods.last_turn(parent, cycle)
        return cycle

    def send(self, outputs: list[Delivery]) -> None:
        """Publish what the agent decided."""
        for port, message in outputs:
            self.bus.publish(port, message)
            if self._stopwatch is not None:
                self._stopwatch.handed_over(message)

    def begin(self, start_time_ns: int) -> None:
        """Begin cycle 0, in real time with deadlines that count from this monotonic time."""
        if not self.plan.lockstep:
            self._start_time_ns = start_time_ns
        if self._stopwatch is not None:
            self._stopwatch.begin(start_time_ns)
        if self._interlude is not None:
            self._interlude.begin(start_time_ns)
        if self.sequencer.cycle < 0:
            self.send(self.sequencer.enter(0))

    def _heed(self, message: Message) -> None:
        """Follow the plant's word on the beginning and the end of the run."""
        if not isinstance(message, Run):
            return
        if message.state == "stop":
            self.sequencer.end_before(message.cycle)
            self._stop_heard = True
        elif self._start_heard:
            # All deadlines count from the first one.
            self._drop_log("run: the run begins a second time")
        else:
            self._start_heard = True
            self.begin(self._believable_start_ns(message))

    def _believable_start_ns(self, start: Run) -> int:
        """Return when cycle 0 begins: as the plant says, or now if that can be in no earnest.

        Who believed a beginning minutes ago would give up all cycles since then at once.
        """
        plan, now_ns = self.plan, self._now_ns()
        if start.cycle_wall_ns != plan.cycle_wall_ns:
            log.warning(
                "the plant says that cycles last %d ns; those of the plan last %d, and hold",
                start.cycle_wall_ns,
                plan.cycle_wall_ns,
            )
        ahead_ns = start.start_time_ns - now_ns
        if plan.lockstep or abs(ahead_ns) <= START_WITHIN_NS:
            return start.start_time_ns
        log.warning(
            "the plant says that the run begins %.0f s %s: start_time_ns is %d, and the monotonic "
            "clock of this host at %d; cycle 0 begins now instead",
            abs(ahead_ns) / 1e9,
            "from now" if ahead_ns > 0 else "ago",
            start.start_time_ns,
            now_ns,
        )
        return now_ns

    def _until_deadline_s(self) -> float | None:
        """Time left for the open stage, 0 if it is over, None if it has no deadline."""
        if self._start_time_ns is None or not self.sequencer.stage or self.sequencer.cycle < 0:
            return None
        stage = self.sequencer.stage
        if stage not in self._deadlines_ns:
            self._deadlines_ns[stage] = self.plan.deadlines.deadline_ns(self.agent.name, stage)
        began_ns = self._start_time_ns + self.sequencer.cycle * self.plan.cycle_wall_ns
        left_ns = began_ns + self._deadlines_ns[stage] - self._now_ns()
        return max(left_ns, 0) / 1e9

    def _make_interlude(self, stopwatch: Stopwatch) -> Interlude:
        agents = self.plan.tree.agents()
        return Interlude(
            stopwatch,
            lambda: self._say_counts(stopwatch),
            self.plan.cycle_wall_ns,
            agents.index(self.agent.name),
            len(agents),
            self._now_ns,
        )
