"""Live controllers among recorded agents: gives them their inputs, compares what they publish.

The other agents do what they did, whatever the live ones publish: the loop is open. In lockstep a
cycle begins when the live controllers have finished the earlier ones. In real time every message
goes out at its recorded time, and the live controllers have their deadlines.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from itertools import count
from typing import Final

import msgspec
import zenoh
from msgspec.structs import replace

from agents.cycle import stage_of
from agents.machine import MachineSettings
from agents.plan import RunPlan
from bus_schemas.codec import decode, encode
from bus_schemas.messages import Message, Run
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import REPLAYER, ROOT, some_of
from bus_schemas.zenoh_bus import Inbox
from launch_scripts.launcher.interruption import Interruption
from launch_scripts.launcher.supervision import Children, RunFailure, stall
from recordings.read.gaps import due_step
from recordings.read.reader import RunReader
from recordings.replay.bus import ReplayBus
from recordings.verify.comparison import Comparison
from recordings.verify.findings import Findings
from sim_plant.plant_run import FIRST_ROUND, longest_round_s

_ARMING_S: Final = 30.0
_EARLY_CYCLES: Final = 100
"""In so many first cycles everybody has published, even if messages were lost."""

_LOOK_S: Final = 0.1
"""How often the processes are checked."""

_END_S: Final = 5.0
"""How long the live controllers may take to end after the run."""


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
            self._compare(port, message, other, is_recorded=is_recorded)

    def finish(self, before_cycle: int) -> None:
        """Count the messages without a counterpart in the cycles before one."""
        for (port, cycle, is_recorded), message in self._waiting.items():
            if cycle < before_cycle:
                self._compare(port, message, None, is_recorded=is_recorded)

    def _compare(
        self, port: Port[Message], one: Message, other: Message | None, *, is_recorded: bool
    ) -> None:
        recorded, new = (one, other) if is_recorded else (other, one)
        stage = stage_of(port, self._tree)
        self.findings[port.publisher].compare(self._comparison, port, recorded, new, stage)


class LiveBus(ReplayBus):
    """Gives live controllers what the others said, observers what all say, and compares.

    The plan is that of the live controllers, see `live_plan`; its cycles are those to run.

    cycles: How many are over.
    """

    def __init__(
        self,
        plan: RunPlan,
        live: Collection[str],
        tcp_port: int,
        observers: ReplayBus,
        children: Children,
        interruption: Interruption,
    ) -> None:
        keys = plan.wiring
        of_live = [port for port in keys.ports if port.publisher in live]
        others = [port for port in keys.ports if port.publisher not in {REPLAYER, *live}]
        super().__init__(plan, others, f"tcp/127.0.0.1:{tcp_port}")
        self.comparison = LiveComparison(plan, live)
        self.cycles = 0
        self._observers = observers
        self._children = children
        self._interruption = interruption
        self._live = live
        self._inbox = Inbox()
        self._subscribers = [
            self.session.declare_subscriber(
                keys.key(port),
                zenoh.handlers.Callback(self._inbox.callback(port), indirect=False),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for port in of_live
        ]
        self._steps = {port: step for port in of_live if (step := due_step(plan, port))}
        self._newest: dict[Port[Message], int] = {}
        self._received = 0
        self._look_at = 0.0

    def arm(self, reader: RunReader) -> None:
        """Send arming rounds until the live controllers are there and answer a whole one.

        In a round the other agents publish what they published first in the run.
        """
        first = self._first_messages(reader)
        give_up_at = time.monotonic() + _ARMING_S
        for number in count(1):
            cycle = FIRST_ROUND + number
            sim_time_ns = self._plan.sim_time_ns(cycle)
            for port, message in first.items():
                stamped = replace(message, cycle=cycle, sim_time_ns=sim_time_ns, missing=())
                super().put(port, encode(stamped))
            silent = self._await(cycle, longest_round_s(number))
            if not silent:
                return
            if self._interruption:
                raise KeyboardInterrupt
            if time.monotonic() > give_up_at:
                names = some_of(sorted(map(str, silent)))
                raise RunFailure(f"no arming round closed: nothing came on {names}")

    def put(self, port: Port[Message], payload: bytes) -> bool:
        """Take in a recorded message; return whether it was sent as it is."""
        if port.signal is RUN:
            run = decode(RUN, payload)
            if run.state == "start":
                lead_ns = run.start_time_ns - run.publish_time_ns
                self._say(replace(run, start_time_ns=time.monotonic_ns() + lead_ns))
            return False
        if port.publisher in self._live:
            message = decode(port.signal, payload)
            self.comparison.take(port, message, is_recorded=True)
            return False
        self._observers.put(port, payload)
        return super().put(port, payload)

    def announce(self, cycle: int, *, rate: float, paused: bool) -> None:
        """Let a cycle begin: in lockstep, once the live controllers have come near."""
        # One agent may be some cycles ahead of another.
        self._complete(cycle - self._plan.periods.longest)
        self._observers.announce(cycle, rate=rate, paused=paused)

    def listen(self, seconds: float) -> None:
        """Take in what the live controllers publish, until something has come or a time is over."""
        self._receive(1, seconds)

    def finish(self) -> None:
        """End the run, unless the user did, and compare what is left."""
        self._complete(self._plan.cycles)
        if not self._interruption:
            self._say(self._plan.run_message("stop", self.cycles, 0))
            self._receive_the_last()
        self.comparison.finish(self.cycles)

    def _first_messages(self, reader: RunReader) -> dict[Port[Message], Message]:
        """Return the first message of each port on which the others publish in every cycle."""
        others = (port for port in self._plan.wiring.ports if port.publisher not in self._live)
        wanted = {port for port in others if due_step(self._plan, port)}
        first: dict[Port[Message], Message] = {}
        for port, message in reader.on(wanted, range(_EARLY_CYCLES)):
            first.setdefault(port, message)
            if len(first) == len(wanted):
                break
        return first

    def _complete(self, cycles: int) -> None:
        """Go on to some number of cycles: in lockstep, wait until they are over."""
        while self.cycles < cycles and not self._interruption:
            # The live controllers themselves report what they wait for.
            patience_s = self._plan.stall_timeout_s + 1.0
            if self._plan.lockstep and self._await(self.cycles, patience_s):
                if self._interruption:
                    return
                if any(child.waiting for child in self._children):
                    raise RunFailure(stall(self._children)[0])
                raise RunFailure(f"stalled in cycle {self.cycles}")
            self.cycles += 1

    def _await(self, cycle: int, patience_s: float) -> set[Port[Message]]:
        """Wait for all that the live controllers publish in a cycle, or in an arming round.

        Returns the ports on which nothing came, though nothing else came for a time either.
        """
        awaited = {port for port, step in self._steps.items() if cycle < 0 or cycle % step == 0}
        until = time.monotonic() + patience_s
        while awaited := {p for p in awaited if self._newest.get(p, FIRST_ROUND) < cycle}:
            if self._receive(len(awaited), _LOOK_S):
                until = time.monotonic() + patience_s
            if self._interruption or time.monotonic() > until:
                break
        return awaited

    def _receive(self, wanted: int, timeout_s: float) -> int:
        """Compare what the live controllers publish within a time; return how much it was."""
        taken = self._inbox.take(wanted, timeout_s)
        for port, received, _ in taken:
            payload = received.to_bytes()
            try:
                message = decode(port.signal, payload)
            except msgspec.DecodeError as error:
                expected = port.signal.type.__name__
                raise RunFailure(f"{port}: expected a {expected}, got: {error}") from None
            self._newest[port] = message.cycle
            if message.cycle >= 0:
                self._received += 1
                self._observers.put(port, payload)
                self.comparison.take(port, message, is_recorded=False)
        if time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LOOK_S
            self._children.events(0.0)
        return len(taken)

    def _receive_the_last(self) -> None:
        """Let the live controllers end, and receive all that they have sent."""
        if late := self._children.await_exit(list(self._children), _END_S):
            agent = late[0].agent
            raise self._children.failure(agent, f"{agent} did not end with the run")
        ended = [child.finished for child in self._children if child.finished is not None]
        sent = sum(sum(finished.published.values()) for finished in ended)
        until = time.monotonic() + _END_S
        while self._received < sent and time.monotonic() < until:
            self._receive(sent - self._received, _LOOK_S)

    def _say(self, run: Run) -> None:
        """Tell all that the run begins or ends."""
        port = RUN.of(ROOT)
        self._outbox.stamp(port, run, time.monotonic_ns())
        for put in (super().put, self._observers.put):
            put(port, encode(run))
