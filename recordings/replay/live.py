"""Live agents among recorded ones: gives them what they were given, compares what they say now.

The others do what they did, whatever the live ones say: the loop is open. In lockstep the live
agents set the pace: the inputs of a cycle go out when all their outputs of the last one are there.
In real time everything goes out when it did, and the live agents have their deadlines.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator
from typing import Final, Literal

from msgspec.structs import replace

from agents.cycle import stage_of
from agents.events import Waiting
from agents.machine import wake_precisely
from agents.plan import RunPlan
from bus_schemas.codec import decode, encode
from bus_schemas.messages import Clock, Message
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import REPLAYER, ROOT
from launch_scripts.launcher.interruption import Interruption
from launch_scripts.launcher.supervision import Children, RunFailure, with_log
from recordings.read.reader import RecordedMessage
from recordings.replay.absent_agents import AbsentAgents, steady_ports
from recordings.replay.figures import TimingErrors
from recordings.replay.progress import ProgressLine
from recordings.replay.recorded_run import RecordedRun
from recordings.replay.session import ReplaySession
from recordings.verify.account import Account
from recordings.verify.comparison import Comparison
from sim_plant.plant_run import FIRST_ROUND, longest_round_s

_ARMING_S: Final = 30.0
_EARLY_CYCLES: Final = 100
"""In so many first cycles everybody has published, even where messages got lost."""

_LEAD_S: Final = 0.2
"""In real time: how long before cycle 0 the live agents are told when it begins."""

_LOOK_S: Final = 0.1
"""How often the processes are looked at."""

_PATIENCE_S: Final = 5.0
"""How long the live agents may take to end, once all is said."""


class LiveComparison:
    """Compares live agents' messages with the recorded ones, whichever of the two comes first.

    Attributes
    ----------
    accounts
        What the comparison of each live agent came to.
    """

    def __init__(self, plan: RunPlan, live: Iterable[str]) -> None:
        self.accounts = {agent: Account() for agent in live}
        self._tree = plan.tree
        self._comparison = Comparison()
        self._recorded: dict[tuple[Port[Message], int], Message] = {}
        self._new: dict[tuple[Port[Message], int], Message] = {}

    def take_recorded(self, port: Port[Message], message: Message) -> None:
        """Take in what an agent published when it was recorded."""
        self.accounts[port.publisher].recorded += 1
        new = self._new.pop((port, message.cycle), None)
        if new is None:
            self._recorded[port, message.cycle] = message
        else:
            self._compare(port, message, new)

    def take_new(self, port: Port[Message], message: Message) -> None:
        """Take in what it publishes now."""
        recorded = self._recorded.pop((port, message.cycle), None)
        if recorded is None:
            self._new[port, message.cycle] = message
        else:
            self._compare(port, recorded, message)

    def conclude(self, before_cycle: int) -> None:
        """Count what has no counterpart in the cycles before one."""
        for (port, cycle), message in self._recorded.items():
            if cycle < before_cycle:
                self._compare(port, message, None)
        for (port, cycle), message in self._new.items():
            if cycle < before_cycle:
                self._compare(port, None, message)

    def _compare(self, port: Port[Message], recorded: Message | None, new: Message | None) -> None:
        stage = stage_of(port, self._tree)
        self.accounts[port.publisher].compare(self._comparison, port, recorded, new, stage)


class LiveReplay:
    """A recording with live agents in it.

    Parameters
    ----------
    recorded
        The recording.
    plan
        Of the live agents; its cycles are those to run.
    live
        Their names.
    children
        Their processes.
    absent
        All others' place on the bus.
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
        recorded: RecordedRun,
        plan: RunPlan,
        live: Collection[str],
        children: Children,
        absent: AbsentAgents,
        observers: ReplaySession,
        interruption: Interruption,
        progress: ProgressLine,
    ) -> None:
        self.comparison = LiveComparison(plan, live)
        self.timing = TimingErrors()
        self.cycles = 0
        self._recorded = recorded
        self._plan = plan
        self._live = frozenset(live)
        self._children = children
        self._absent = absent
        self._observers = observers
        self._interruption = interruption
        self._progress = progress
        self._heard = 0
        self._newest: dict[Port[Message], int] = {}
        self._announced = -1
        self._look_at = 0.0
        self._waiting: dict[str, Waiting] = {}

    # Before cycle 0 -------------------------------------------------------------------------------

    def arm(self) -> None:
        """Wait for the live agents, and for an arming round of theirs to close.

        What the others say in a round is the first that they said in the run.

        Raises
        ------
        RunFailure
            A live agent does not come, or says nothing.
        KeyboardInterrupt
            The user has asked for an end.
        """
        give_up_at = time.monotonic() + _ARMING_S
        while names := self._absent.not_there():
            self._look(0.02)
            if time.monotonic() > give_up_at:
                raise RunFailure(f"no sign of life from {', '.join(names)}")
        first = self._first_messages()
        steady = steady_ports(self._plan, self._live, FIRST_ROUND)
        silent, rounds = steady, 0
        while silent:
            rounds += 1
            cycle = FIRST_ROUND + rounds
            self._begin_round(cycle, first)
            silent = set(steady)
            until = time.monotonic() + longest_round_s(rounds)
            while silent and time.monotonic() < until:
                heard = self._absent.receive(len(silent), _LOOK_S)
                silent -= {port for port, message, _ in heard if message.cycle == cycle}
                self._look(0.0)
            if silent and time.monotonic() > give_up_at:
                names = sorted(map(str, silent))
                raise RunFailure(f"no arming round closed: nothing came on {', '.join(names)}")

    def _first_messages(self) -> dict[Port[Message], Message]:
        """Return the first message of each port on which the others publish in every cycle."""
        others = set(self._plan.tree.agents()) - self._live
        wanted = steady_ports(self._plan, others, FIRST_ROUND)
        first: dict[Port[Message], Message] = {}
        for record in self._recorded.records(wanted, before_cycle=_EARLY_CYCLES):
            if record.port not in first:
                first[record.port] = decode(record.port.signal, record.payload)
                if len(first) == len(wanted):
                    break
        return first

    def _begin_round(self, cycle: int, first: dict[Port[Message], Message]) -> None:
        sim_time_ns = self._plan.sim_time_ns(cycle)
        for port, message in first.items():
            stamped = replace(message, cycle=cycle, sim_time_ns=sim_time_ns, missing=())
            self._absent.put(port, encode(stamped))

    # The run --------------------------------------------------------------------------------------

    def run(self) -> None:
        """Take the live agents through the run, and compare.

        Raises
        ------
        RunFailure
            One of them died, gave up, or says nothing any more.
        """
        wake_precisely()
        if self._plan.lockstep:
            self._run_in_lockstep()
        else:
            self._run_in_real_time()
        self._publish_run("stop", self.cycles, 0)
        self._hear_the_last()
        self.comparison.conclude(self.cycles)

    def _run_in_lockstep(self) -> None:
        self._publish_run("start", 0, time.monotonic_ns())
        records = self._recorded.records(before_cycle=self._plan.cycles)
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
        for record in self._recorded.records(before_cycle=self._plan.cycles):
            due_ns = record.publish_time_ns + shift_ns
            while (left_ns := due_ns - time.monotonic_ns()) > 0:
                self._listen(1, min(left_ns / 1e9, _LOOK_S))
            if self._pass_on(record):
                self.timing.add(time.monotonic_ns() - due_ns)
            self.cycles = max(self.cycles, record.cycle + 1)
            self._progress.show(record.cycle)
            if self._interruption:
                return

    def _recorded_start_ns(self) -> int:
        """Wall time at which cycle 0 of the recorded run began [ns]."""
        for record in self._recorded.records([RUN.of(ROOT)]):
            message = decode(RUN, record.payload)
            if message.state == "start":
                return record.publish_time_ns + message.start_time_ns - message.publish_time_ns
        raise RunFailure(f"{self._recorded.path}: the message that starts the run is not in it")

    def _pass_on(self, record: RecordedMessage) -> bool:
        """Send a recorded message, or keep it to be compared. Return whether it was sent."""
        port = record.port
        if port.signal is RUN:
            return False
        self._announce(record.cycle)
        if port.publisher in self._live:
            self.comparison.take_recorded(port, decode(port.signal, record.payload))
            return False
        self._absent.put(port, record.payload)
        self._observers.put(self._plan.keys.key(port), record.payload)
        return True

    def _await(self, cycle: int) -> None:
        """Wait for all that the live agents must say in a cycle."""
        steady = steady_ports(self._plan, self._live, cycle)
        patience_s = self._plan.stall_timeout_s + 1.0  # They say themselves what they wait for.
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
        heard = self._absent.receive(wanted, timeout_s)
        for port, message, payload in heard:
            if message.cycle >= 0:
                self._heard += 1
                self._newest[port] = message.cycle
                self._observers.put(self._plan.keys.key(port), payload)
                self.comparison.take_new(port, message)
        if time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LOOK_S
            self._note_waiting(0.0)
        return len(heard)

    def _look(self, timeout_s: float) -> None:
        """See whether all processes live and the user still wants them to."""
        self._note_waiting(timeout_s)
        if self._interruption:
            raise KeyboardInterrupt

    def _note_waiting(self, timeout_s: float) -> None:
        for child, event in self._children.events(timeout_s):
            if isinstance(event, Waiting):
                self._waiting[child.agent] = event

    def _hear_the_last(self) -> None:
        """Let the live agents end, and take in all that they say they have sent."""
        late = self._children.await_exit(list(self._children), _PATIENCE_S)
        if late:
            names = ", ".join(child.agent for child in late)
            raise RunFailure(with_log(late[0], f"{names} did not end with the run"))
        accounts = [child.finished for child in self._children if child.finished is not None]
        sent = sum(sum(account.published.values()) for account in accounts)
        until = time.monotonic() + _PATIENCE_S
        while self._heard < sent and time.monotonic() < until:
            self._listen(sent - self._heard, _LOOK_S)

    def _publish_run(self, state: Literal["start", "stop"], cycle: int, start_ns: int) -> None:
        """Say to live agents and observers that the run begins, or is over."""
        port = RUN.of(ROOT)
        message = self._plan.run_message(state, cycle, start_ns)
        message.publish_time_ns = time.monotonic_ns()
        message.sequence = int(state == "stop")
        payload = encode(message)
        self._absent.put(port, payload)
        self._observers.put(self._plan.keys.key(port), payload)

    def _announce(self, cycle: int) -> None:
        if cycle > self._announced:
            self._announced = cycle
            rate = 0.0 if self._plan.lockstep else 1.0
            sim_time_ns = self._plan.sim_time_ns(cycle)
            self._observers.announce(
                Clock(cycle, sim_time_ns, REPLAYER, (), rate=rate, paused=False)
            )

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
