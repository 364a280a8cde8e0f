"""Live agents among recorded ones: gives them what they were given, hears what they say now.

The others do what they did, whatever the live ones say: the loop is open. In lockstep the live
agents set the pace: the inputs of a cycle go out when all their outputs of the last one are there.
In real time everything goes out when it did, and the live agents have their deadlines.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator
from typing import Final, Literal

from agents.events import Waiting
from agents.garbage import spare_the_collector
from agents.histograms import new_histogram, record_ns
from agents.machine import wake_precisely
from agents.plan import RunPlan
from bus_schemas.bus import Outbox
from bus_schemas.codec import decode, encode
from bus_schemas.messages import Clock, Message
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import REPLAYER, ROOT
from launch_scripts.interruption import Interruption
from launch_scripts.replay.output_comparison import OutputComparison
from launch_scripts.replay.progress import ProgressLine
from launch_scripts.replay.session import ReplaySession
from launch_scripts.replay.stand_in import StandIn, steady_ports
from launch_scripts.replay.tape import Tape
from launch_scripts.supervision import Children, RunFailure, with_log
from recordings.reader import RecordedMessage

_LEAD_S: Final = 0.2
"""In real time: how long before cycle 0 the live agents are told when it begins."""

_LOOK_S: Final = 0.1
"""How often the processes are looked at."""

_PATIENCE_S: Final = 5.0
"""How long the live agents may take to end, once all is said."""


class LiveReplay:
    """A recording with live agents in it, which are armed.

    Parameters
    ----------
    tape
        The recording.
    plan
        Of the live agents; its cycles are those to run.
    live
        Their names.
    children
        Their processes.
    stand_in
        The place of all others on the bus.
    observers
        Where everything goes out again, for subscribers.
    interruption
        Ends it.
    progress
        Shows it.

    Attributes
    ----------
    comparison
        What the live agents say beside what they said.
    timing
        In real time: how late the recorded messages went out.
    cycles
        Cycles that have been replayed.
    """

    def __init__(
        self,
        tape: Tape,
        plan: RunPlan,
        live: Collection[str],
        children: Children,
        stand_in: StandIn,
        observers: ReplaySession,
        interruption: Interruption,
        progress: ProgressLine,
    ) -> None:
        self.comparison = OutputComparison()
        self.timing = new_histogram()
        self.cycles = 0
        self._tape = tape
        self._plan = plan
        self._live = frozenset(live)
        self._children = children
        self._stand_in = stand_in
        self._observers = observers
        self._interruption = interruption
        self._progress = progress
        self._outbox = Outbox()
        self._heard = 0
        self._newest: dict[Port[Message], int] = {}
        self._announced = -1
        self._look_at = 0.0
        self._waiting: dict[str, Waiting] = {}

    def run(self) -> None:
        """Take the live agents through the run, and compare.

        Raises
        ------
        RunFailure
            One of them died, gave up, or says nothing any more.
        """
        wake_precisely()
        spare_the_collector()
        if self._plan.lockstep:
            self._run_in_lockstep()
        else:
            self._run_in_real_time()
        self._publish_run("stop", self.cycles, 0)
        self._hear_the_last()
        self.comparison.conclude(self.cycles)

    def _run_in_lockstep(self) -> None:
        self._publish_run("start", 0, time.monotonic_ns())
        records = self._tape.records(before_cycle=self._plan.cycles)
        for cycle, group in by_cycle(records, self._plan.periods.longest):
            for record in group:
                self._pass_on(record)
            self._await(cycle)
            if self._interruption:
                return
            self.cycles = cycle + 1
            self._progress.show(cycle)

    def _run_in_real_time(self) -> None:
        start_ns = time.monotonic_ns() + round(_LEAD_S * 1e9)
        shift_ns = start_ns - self._recorded_start_ns()
        self._publish_run("start", 0, start_ns)
        for record in self._tape.records(before_cycle=self._plan.cycles):
            due_ns = record.publish_time_ns + shift_ns
            while (left_ns := due_ns - time.monotonic_ns()) > 0:
                self._listen(1, min(left_ns / 1e9, _LOOK_S))
            if self._pass_on(record):
                record_ns(self.timing, time.monotonic_ns() - due_ns)
            self.cycles = max(self.cycles, record.cycle + 1)
            self._progress.show(record.cycle)
            if self._interruption:
                return

    def _recorded_start_ns(self) -> int:
        """Wall time at which cycle 0 of the recorded run began [ns]."""
        for record in self._tape.records([RUN.of(ROOT)]):
            message = decode(RUN, record.payload)
            if message.state == "start":
                return record.publish_time_ns + message.start_time_ns - message.publish_time_ns
        raise RunFailure(f"{self._tape.path}: the message that starts the run is not in it")

    def _pass_on(self, record: RecordedMessage) -> bool:
        """Send a recorded message, or keep it to be compared. Return whether it was sent."""
        port = record.port
        if port.signal is RUN:
            return False
        self._announce(record)
        if port.publisher in self._live:
            self.comparison.take_recorded(port, decode(port.signal, record.payload))
            return False
        self._stand_in.put(port, record.payload)
        self._observers.put(self._plan.keys.key(port), record.payload)
        return True

    def _await(self, cycle: int) -> None:
        """Wait for all that the live agents must say in a cycle."""
        steady = steady_ports(self._plan, self._live, cycle)
        patience_s = self._plan.stall_timeout_s + 1.0  # they say themselves what they wait for
        give_up_at = time.monotonic() + patience_s
        while awaited := {port for port in steady if self._newest.get(port, -1) < cycle}:
            if self._listen(len(awaited), _LOOK_S):
                give_up_at = time.monotonic() + patience_s
            elif time.monotonic() > give_up_at:
                raise RunFailure(self._explain_stall(cycle, awaited))
            if self._interruption:
                return

    def _listen(self, wanted: int, timeout_s: float) -> int:
        """Take in what the live agents say within a time; return how much it was."""
        heard = self._stand_in.receive(wanted, timeout_s)
        for port, message, payload in heard:
            if message.cycle >= 0:
                self._heard += 1
                self._newest[port] = message.cycle
                self._observers.put(self._plan.keys.key(port), payload)
                self.comparison.take_new(port, message)
        now = time.monotonic()
        if now >= self._look_at:
            self._look_at = now + _LOOK_S
            for child, event in self._children.events(0.0):
                if isinstance(event, Waiting):
                    self._waiting[child.spec.agent] = event
        return len(heard)

    def _hear_the_last(self) -> None:
        """Let the live agents end, and take in all that they say they have sent."""
        late = self._children.await_exit(list(self._children), _PATIENCE_S)
        if late:
            names = ", ".join(child.spec.agent for child in late)
            raise RunFailure(with_log(late[0], f"{names} did not end with the run"))
        accounts = [child.finished for child in self._children if child.finished is not None]
        sent = sum(sum(account.published.values()) for account in accounts)
        until = time.monotonic() + _PATIENCE_S
        while self._heard < sent and time.monotonic() < until:
            self._listen(sent - self._heard, _LOOK_S)

    def _publish_run(self, state: Literal["start", "stop"], cycle: int, start_ns: int) -> None:
        """Say to live agents and observers that the run begins, or is over."""
        port = RUN.of(ROOT)
        message = self._outbox.stamp(port, self._plan.run_message(state, cycle, start_ns))
        payload = encode(message)
        self._stand_in.put(port, payload)
        self._observers.put(self._plan.keys.key(port), payload)

    def _announce(self, record: RecordedMessage) -> None:
        if record.cycle > self._announced:
            self._announced = record.cycle
            rate = 0.0 if self._plan.lockstep else 1.0
            sim_time_ns = self._plan.sim_time_ns(record.cycle)
            clock = Clock(record.cycle, sim_time_ns, REPLAYER, (), rate=rate, paused=False)
            self._observers.announce(clock)

    def _explain_stall(self, cycle: int, awaited: Iterable[Port[Message]]) -> str:
        lines = [f"stalled in cycle {cycle}"]
        silent: dict[str, list[str]] = {}
        for port in sorted(awaited, key=str):
            silent.setdefault(port.publisher, []).append(str(port))
        for agent, keys in silent.items():
            line = f"nothing came from {agent} on {', '.join(keys)}"
            waiting = self._waiting.get(agent)
            if waiting is not None and waiting.needs:
                needs = ", ".join(f"{key} from {publisher}" for key, publisher in waiting.needs)
                line += f": it waits for {needs}"
            lines.append(line)
        return "\n  ".join(lines)


def by_cycle(
    records: Iterable[RecordedMessage], ahead: int
) -> Iterator[tuple[int, list[RecordedMessage]]]:
    """Yield cycle after cycle and its messages, from cycle 0 on.

    Parameters
    ----------
    records
        In the order of their publishing.
    ahead
        How many cycles one agent can be ahead of another.
    """
    waiting: dict[int, list[RecordedMessage]] = {}
    cycle = 0
    for record in records:
        waiting.setdefault(max(record.cycle, cycle), []).append(record)
        while record.cycle > cycle + ahead:
            yield cycle, waiting.pop(cycle, [])
            cycle += 1
    while waiting:
        yield cycle, waiting.pop(cycle, [])
        cycle += 1
