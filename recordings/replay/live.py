"""Live controllers among recorded agents: gives them their inputs, compares what they publish.

The other agents do what they did, whatever the live ones publish: the loop is open. In lockstep the
inputs of a cycle are sent when the live controllers have published all of the last one. In real
time every message is sent when it was, and the live controllers have their deadlines.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import zenoh
from msgspec.structs import replace

from agents.cycle import stage_of
from agents.machine import MachineSettings, wake_precisely
from agents.plan import RunPlan
from bus_schemas.codec import decode, encode
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import REPLAYER, ROOT
from bus_schemas.zenoh_bus import Inbox
from launch_scripts.launcher.interruption import Interruption
from launch_scripts.launcher.live_view import StatusLine
from launch_scripts.launcher.supervision import Children, RunFailure
from recordings.read.gaps import due_step
from recordings.read.reader import RecordedMessage, RunReader
from recordings.replay.bus import ReplayBus
from recordings.replay.clock import TimingErrors
from recordings.replay.playback import cycle_text
from recordings.replay.publish_order import in_publish_order
from recordings.verify.comparison import Comparison
from recordings.verify.findings import Findings
from sim_plant.plant_run import FIRST_ROUND, longest_round_s

_ARMING_S: Final = 30.0
_EARLY_CYCLES: Final = 100
"""In so many first cycles everybody has published, even if messages were lost."""

_LEAD_S: Final = 0.2
"""In real time: how long before cycle 0 the live controllers learn when it begins."""

_LOOK_S: Final = 0.1
"""How often the processes are checked."""

_END_S: Final = 5.0
"""How long the live controllers may take to end after the run."""


class LiveBus(ReplayBus):
    """Publishes for all agents but the live ones, and receives what the live ones publish.

    The live ones run by `live_plan`, and connect to the TCP port.
    """

    def __init__(self, plan: RunPlan, live: Collection[str], tcp_port: int) -> None:
        keys = plan.keys
        others = [port for port in keys.ports if port.publisher not in {REPLAYER, *live}]
        super().__init__(plan, others, f"tcp/127.0.0.1:{tcp_port}")
        self._inbox = Inbox()
        self._subscribers = [
            self.session.declare_subscriber(
                keys.key(port),
                zenoh.handlers.Callback(self._inbox.callback(port), indirect=False),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for port in keys.ports
            if port.publisher in live
        ]

    def receive(self, wanted: int, timeout_s: float) -> list[tuple[Port[Message], Message, bytes]]:
        """Return what the live controllers have sent, once there is enough or at the time-out.

        Each message comes with its port, and as bytes.
        """
        received = []
        for port, payload, _ in self._inbox.take(wanted, timeout_s):
            data = payload.to_bytes()
            try:
                received.append((port, decode(port.signal, data), data))
            except msgspec.DecodeError as error:
                raise RunFailure(
                    f"{port}: expected a {port.signal.type.__name__}, got: {error}"
                ) from None
        return received


def live_plan(plan: RunPlan, live: Iterable[str], tcp_ports: dict[str, int], port: int) -> RunPlan:
    """Return the plan by which live controllers find each other, and all others at one TCP port.

    That port is of the `LiveBus`: every agent connects to the recorder, and so to it.
    """
    everybody = dict.fromkeys(plan.links.listening, port)
    everybody.update({agent: tcp_ports[agent] for agent in live if agent in everybody})
    return replace(
        plan.public,
        tcp_ports=everybody,
        namespace="",
        external=(),
        address="127.0.0.1",
        addresses={},
        faults=(),
        machine=MachineSettings(),
    )


def steady_ports(plan: RunPlan, agents: Collection[str], cycle: int) -> set[Port[Message]]:
    """Return the ports on which agents publish in a cycle, whatever they decide.

    In arming rounds, which have negative numbers, those are all that publish regularly.
    """
    steps = {port: due_step(plan, port) for port in plan.keys.ports if port.publisher in agents}
    return {port for port, step in steps.items() if step and (cycle < 0 or cycle % step == 0)}


class LiveComparison:
    """Compares new messages with the recorded ones, whichever comes first."""

    def __init__(self, plan: RunPlan, live: Iterable[str]) -> None:
        self.findings = {agent: Findings() for agent in live}
        self._tree = plan.tree
        self._comparison = Comparison()
        self._waiting: dict[tuple[Port[Message], int, bool], Message] = {}

    def take(self, port: Port[Message], message: Message, *, is_recorded: bool) -> None:
        """Compare a message with its counterpart, now or when that comes."""
        self.findings[port.publisher].recorded += is_recorded
        other = self._waiting.pop((port, message.cycle, not is_recorded), None)
        if other is None:
            self._waiting[port, message.cycle, is_recorded] = message
        else:
            self._compare(port, *((message, other) if is_recorded else (other, message)))

    def finish(self, before_cycle: int) -> None:
        """Count the messages without a counterpart in the cycles before one."""
        for (port, cycle, is_recorded), message in self._waiting.items():
            if cycle < before_cycle:
                self._compare(port, *((message, None) if is_recorded else (None, message)))

    def _compare(self, port: Port[Message], recorded: Message | None, new: Message | None) -> None:
        stage = stage_of(port, self._tree)
        self.findings[port.publisher].compare(self._comparison, port, recorded, new, stage)


@dataclass(eq=False)
class LiveReplay:
    """A recording with live controllers in it.

    The plan is that of the live controllers; its cycles are those to run. In real time, `timing`
    says how late recorded messages were sent.
    """

    reader: RunReader
    plan: RunPlan
    live: Collection[str]
    children: Children
    bus: LiveBus
    observers: ReplayBus
    interruption: Interruption
    line: StatusLine

    def __post_init__(self) -> None:
        self.comparison = LiveComparison(self.plan, self.live)
        self.timing = TimingErrors()
        self.cycles = 0
        self._received = 0
        self._newest: dict[Port[Message], int] = {}
        self._announced = -1
        self._look_at = 0.0

    def arm(self) -> None:
        """Send arming rounds until the live controllers are there and answer a whole one.

        In a round the other agents publish what they published first in the run.
        """
        give_up_at = time.monotonic() + _ARMING_S
        first = self._first_messages()
        number = 0
        while silent := self._run_round(number, first):
            number += 1
            if time.monotonic() > give_up_at:
                names = ", ".join(sorted(map(str, silent)))
                raise RunFailure(f"no arming round closed: nothing came on {names}")

    def run(self) -> None:
        """Take the live controllers through the run, and compare."""
        wake_precisely()
        if self.plan.lockstep:
            self._run_in_lockstep()
        else:
            self._run_in_real_time()
        self._publish_run("stop", self.cycles, 0)
        self._receive_the_last()
        if self.cycles:
            self._show(self.cycles - 1)
        self.line.end()
        self.comparison.finish(self.cycles)

    def _first_messages(self) -> dict[Port[Message], Message]:
        """Return the first message of each port on which the others publish in every cycle."""
        others = set(self.plan.tree.agents()).difference(self.live)
        wanted = steady_ports(self.plan, others, FIRST_ROUND)
        first: dict[Port[Message], Message] = {}
        for record in in_publish_order(self.reader, wanted, before_cycle=_EARLY_CYCLES):
            if record.port not in first:
                first[record.port] = decode(record.port.signal, record.payload)
                if len(first) == len(wanted):
                    break
        return first

    def _run_round(self, number: int, first: dict[Port[Message], Message]) -> set[Port[Message]]:
        """Send an arming round; return the ports of the live controllers without an answer."""
        cycle = FIRST_ROUND + number
        for port, message in first.items():
            sim_time_ns = self.plan.sim_time_ns(cycle)
            stamped = replace(message, cycle=cycle, sim_time_ns=sim_time_ns, missing=())
            self.bus.put(port, encode(stamped))
        silent = steady_ports(self.plan, self.live, cycle)
        until = time.monotonic() + longest_round_s(number + 1)
        while silent and time.monotonic() < until:
            received = self.bus.receive(len(silent), _LOOK_S)
            silent -= {port for port, message, _ in received if message.cycle == cycle}
            self.children.events(0.0)
            if self.interruption:
                raise KeyboardInterrupt
        return silent

    def _run_in_lockstep(self) -> None:
        self._publish_run("start", 0, time.monotonic_ns())
        records = in_publish_order(self.reader, before_cycle=self.plan.cycles)
        for cycle, group in by_cycle(records, self.plan.periods.longest):
            for record in group:
                self._forward(record)
            self._await(cycle)
            if self.interruption:
                return
            self.cycles = cycle + 1
            if self.line.is_due():
                self._show(cycle)

    def _run_in_real_time(self) -> None:
        start_ns = time.monotonic_ns() + round(_LEAD_S * 1e9)
        shift_ns = start_ns - self._recorded_start_ns()
        self._publish_run("start", 0, start_ns)
        for record in in_publish_order(self.reader, before_cycle=self.plan.cycles):
            due_ns = record.publish_time_ns + shift_ns
            while (left_ns := due_ns - time.monotonic_ns()) > 0:
                self._receive(1, min(left_ns / 1e9, _LOOK_S))
            if self._forward(record):
                self.timing.add(time.monotonic_ns() - due_ns)
            self.cycles = max(self.cycles, record.cycle + 1)
            if self.line.is_due():
                self._show(record.cycle)
            if self.interruption:
                return

    def _recorded_start_ns(self) -> int:
        """Return the wall time at which cycle 0 of the recorded run began [ns]."""
        for record in in_publish_order(self.reader, [RUN.of(ROOT)]):
            message = decode(RUN, record.payload)
            if message.state == "start":
                return record.publish_time_ns + message.start_time_ns - message.publish_time_ns
        raise RunFailure(f"{self.reader.path}: expected the message that starts the run, got none")

    def _forward(self, record: RecordedMessage) -> bool:
        """Send a recorded message, or keep it for comparison. Return whether it was sent."""
        port = record.port
        if port.signal is RUN:
            return False
        if record.cycle > self._announced:
            self._announced = record.cycle
            rate = 0.0 if self.plan.lockstep else 1.0
            self.observers.announce(record.cycle, rate=rate, paused=False)
        if port.publisher in self.live:
            message = decode(port.signal, record.payload)
            self.comparison.take(port, message, is_recorded=True)
            return False
        self.bus.put(port, record.payload)
        self.observers.put(port, record.payload)
        return True

    def _await(self, cycle: int) -> None:
        """Wait for all that the live controllers must publish in a cycle."""
        steady = steady_ports(self.plan, self.live, cycle)
        patience_s = self.plan.stall_timeout_s + 1.0  # They report themselves what they wait for.
        give_up_at = time.monotonic() + patience_s
        while awaited := {port for port in steady if self._newest.get(port, -1) < cycle}:
            if self._receive(len(awaited), _LOOK_S):
                give_up_at = time.monotonic() + patience_s
            elif time.monotonic() > give_up_at:
                raise RunFailure(self._explain_stall(cycle, awaited))
            if self.interruption:
                return

    def _receive(self, wanted: int, timeout_s: float) -> int:
        """Compare what the live controllers publish within a time; return how much it was."""
        received = self.bus.receive(wanted, timeout_s)
        for port, message, payload in received:
            if message.cycle >= 0:
                self._received += 1
                self._newest[port] = message.cycle
                self.observers.put(port, payload)
                self.comparison.take(port, message, is_recorded=False)
        if time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LOOK_S
            self.children.events(0.0)
        return len(received)

    def _receive_the_last(self) -> None:
        """Let the live controllers end, and receive all that they have sent."""
        late = self.children.await_exit(list(self.children), _END_S)
        if late:
            names = ", ".join(child.agent for child in late)
            raise self.children.failure(late[0].agent, f"{names} did not end with the run")
        ended = [child.finished for child in self.children if child.finished is not None]
        sent = sum(sum(finished.published.values()) for finished in ended)
        until = time.monotonic() + _END_S
        while self._received < sent and time.monotonic() < until:
            self._receive(sent - self._received, _LOOK_S)

    def _publish_run(self, state: Literal["start", "stop"], cycle: int, start_ns: int) -> None:
        message = self.plan.run_message(state, cycle, start_ns)
        message.publish_time_ns = time.monotonic_ns()
        message.sequence = int(state == "stop")
        for bus in (self.bus, self.observers):
            bus.put(RUN.of(ROOT), encode(message))

    def _show(self, cycle: int) -> None:
        self.line.show(cycle_text(self.reader, cycle, self.plan.cycles - 1))

    def _explain_stall(self, cycle: int, awaited: Iterable[Port[Message]]) -> str:
        silent = sorted(awaited, key=str)
        lines = [f"stalled in cycle {cycle}: nothing came on {', '.join(map(str, silent))}"]
        for agent in dict.fromkeys(port.publisher for port in silent):
            waiting = self.children[agent].waiting
            if waiting is not None:
                needs = ", ".join(f"{key} from {publisher}" for key, publisher in waiting.needs)
                lines.append(f"{agent} waits for {needs}")
        return "\n  ".join(lines)


def by_cycle(
    records: Iterable[RecordedMessage], ahead: int
) -> Iterator[tuple[int, list[RecordedMessage]]]:
    """Yield each cycle with its messages; one agent may be some cycles ahead of another."""
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
