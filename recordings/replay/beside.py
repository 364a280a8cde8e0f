"""Leaves agents out of a replay, so that processes of the user can take their places.

The others do what they did in the run, whatever these processes publish: the loop is open. In
lockstep a cycle begins when they have finished the earlier ones, so a debugger may stop them. In
real time every message goes out at its recorded time, and they have their deadlines.
"""

from __future__ import annotations

import shlex
import sys
import tempfile
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Final, Literal, TextIO

import zenoh
from msgspec.structs import replace

from agents.plan import RunPlan, changed
from agents.process.interruption import Interruption
from agents.process.machine import MachineSettings
from bus_schemas.codec import UNREADABLE, encode
from bus_schemas.errors import InputError, listed
from bus_schemas.inbox import Inbox
from bus_schemas.messages import Message
from bus_schemas.selection import find_nodes
from bus_schemas.signals import CLOCK, RUN, Port
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import REPLAYER, ROOT, agent_name
from recordings.read.gaps import due_step
from recordings.read.reader import RunReader
from recordings.replay.bus import ReplayBus, ReplayOptions, StatusLine, say
from sim_plant.plant_run import FIRST_ROUND, patience_s

_EARLY_CYCLES: Final = 100
"""Every agent publishes within this many first cycles, even if messages are lost."""

_LOOK_S: Final = 0.1
"""How often the user's wish for an end is looked for."""

_NAMED_AFTER_S: Final = 2.0
"""After this time of silence the awaited messages are shown."""


class ReplayBeside(ReplayBus):
    """Publishes what all agents but some published, and follows these on the bus.

    cycles: How many cycles of the plan they have finished.
    """

    def __init__(
        self,
        plan: RunPlan,
        left_out: Sequence[str],
        endpoint: str,
        interruption: Interruption,
        line: StatusLine,
    ) -> None:
        ports = plan.wiring.ports
        super().__init__(plan, [port for port in ports if port.publisher not in left_out], endpoint)
        self.cycles = 0
        self._interruption = interruption
        self._line = line
        self._inbox = Inbox()
        self._newest = {
            port: FIRST_ROUND for port in ports if port.publisher in left_out and port.signal.logged
        }
        self._subscribers = [
            self.session.declare_subscriber(
                plan.wiring.key(port),
                zenoh.handlers.Callback(self._inbox.callback(port), indirect=False),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for port in self._newest
        ]

    def arm(self, reader: RunReader) -> None:
        """Send arming rounds until the processes are there and answer a whole one.

        In a round the other agents publish what they published first in the run.
        """
        first = self._first_messages(reader)
        for number in count(1):
            cycle = FIRST_ROUND + number
            sim_time_ns = self._plan.timing.sim_time_ns(cycle)
            for port, message in first.items():
                stamped = replace(message, cycle=cycle, sim_time_ns=sim_time_ns, missing=())
                super().put(port, encode(stamped))
            if self._await_cycle(cycle, patience_s(number)) or self._interruption:
                return

    def put(self, port: Port[Message], payload: bytes) -> bool:
        """Publish a recorded message; return whether it was sent. The run begins today."""
        if port.signal is not RUN:
            return super().put(port, payload)
        run = RUN.decode(payload)
        if run.state == "start":
            lead_ns = run.start_time_ns - run.publish_time_ns
            self._put_run("start", time.monotonic_ns() + lead_ns)
        return False

    def announce(self, cycle: int, *, rate: float) -> None:
        """Begin a cycle; in lockstep, wait until none of the processes is too far behind."""
        super().announce(cycle, rate=rate)
        # One agent may be some cycles ahead of another.
        self._complete(cycle - self._plan.control.periods.longest)

    def finish(self) -> None:
        """Let the processes finish their last cycle, and end their run."""
        self._complete(self._plan.timing.cycles)
        self._put_run("stop", 0)

    def _put_run(self, state: Literal["start", "stop"], start_time_ns: int) -> None:
        port = RUN.of(ROOT)
        run = self._plan.run_message(state, self.cycles, start_time_ns)
        self._outbox.stamp(port, run, time.monotonic_ns())
        super().put(port, encode(run))

    def _first_messages(self, reader: RunReader) -> dict[Port[Message], Message]:
        wanted = {port for port in self._publishers if due_step(self._plan, port)} - {
            CLOCK.of(ROOT)
        }
        first: dict[Port[Message], Message] = {}
        for port, message in reader.on(wanted, range(_EARLY_CYCLES)):
            first.setdefault(port, message)
            if len(first) == len(wanted):
                break
        return first

    def _complete(self, cycles: int) -> None:
        """Go on to a number of cycles; in lockstep, wait until they are over."""
        while self.cycles < cycles and not self._interruption:
            if self._plan.timing.lockstep and not self._await_cycle(self.cycles, None):
                return
            self.cycles += 1

    def _await_cycle(self, cycle: int, patience_s: float | None) -> bool:
        """Wait until all messages of a cycle, or of a round, came; return whether they did."""
        awaited = {
            port
            for port in self._newest
            if (step := due_step(self._plan, port)) and (cycle < 0 or cycle % step == 0)
        }
        began_at, is_named = time.monotonic(), False
        while awaited := {port for port in awaited if self._newest[port] < cycle}:
            self._receive(len(awaited))
            waited_s = time.monotonic() - began_at
            if self._interruption or (patience_s is not None and waited_s > patience_s):
                return False
            if cycle >= 0 and waited_s > _NAMED_AFTER_S and not is_named:
                is_named = True
                names = listed(sorted(map(str, awaited)), 3)
                self._line.show(f"cycle {cycle} waits for {names}")
        return True

    def _receive(self, wanted: int) -> None:
        """Take in messages of the processes, within a moment."""
        for port, received, _ in self._inbox.take(wanted, _LOOK_S):
            assert isinstance(port, Port)  # Each process has one agent.
            try:
                self._newest[port] = port.signal.decode(received).cycle
            except UNREADABLE as error:
                self._line.show(f"{port}: expected a {port.signal.type.__name__}, got: {error}")


@contextmanager
def replay_beside(
    reader: RunReader,
    options: ReplayOptions,
    interruption: Interruption,
    out: TextIO,
    line: StatusLine,
) -> Iterator[ReplayBeside]:
    """Join the bus without some agents, print how to start them, and wait until they answer."""
    left_out = [
        agent_name(node)
        for node in find_nodes(reader.plan.tree, options.without or "", "--without")
    ]
    plan = _complete_cycles(reader, options.end)
    with (
        tempfile.TemporaryDirectory(prefix="heliarch-replay-") as folder,
        reserved_ports((REPLAYER, *left_out)) as tcp_ports,
    ):
        endpoint = options.listen or f"tcp/127.0.0.1:{tcp_ports[REPLAYER]}"
        tcp_ports[REPLAYER] = int(endpoint.rpartition(":")[2])
        plan = _plan_beside(plan, tcp_ports)
        path = Path(folder) / "plan.json"
        path.write_bytes(plan.as_json())
        with ReplayBeside(plan, left_out, endpoint, interruption, line) as bus:
            say(out, f"{plan.run_id}, {reader.clock.extent()}, without {', '.join(left_out)}")
            say(out, f"endpoint {endpoint}\nkeys {plan.run_id}/{plan.plant}/**")
            for text in _commands(left_out, path, options.process_module):
                say(out, text)
            bus.arm(reader)
            yield bus


def _commands(left_out: Collection[str], plan: Path, module: str) -> Iterator[str]:
    """Yield the commands that start the agents, and one of them in a debugger."""
    for number, agent in enumerate(left_out):
        process = ("-m", module, agent, "--plan", str(plan))
        yield f"start {agent}:  {shlex.join((sys.executable, *process))}"
        if not number:
            yield f"or under pdb:  {shlex.join((sys.executable, '-m', 'pdb', *process))}"


def _complete_cycles(reader: RunReader, end: str | None) -> RunPlan:
    """Return the plan with the complete cycles of the recording."""
    complete = reader.last_cycle + 1
    if reader.stop_cycle is None:  # The run or the recording broke off.
        complete = max(reader.last_cycle - reader.plan.control.periods.longest, 0)
    if not complete:
        raise InputError(f"{reader.path}: expected a complete cycle, got none")
    cycles = min(reader.clock.span(None, end).stop, complete)
    return changed(reader.plan, timing={"cycles": cycles})


def _plan_beside(plan: RunPlan, tcp_ports: dict[str, int]) -> RunPlan:
    """Return the plan by which the processes find each other, and all others at one TCP port."""
    plan = changed(
        plan.public,
        faults={"rules": (), "device": ()},
        supervision={"groups": (), "machine": MachineSettings()},
    )
    ports = {one: tcp_ports.get(one, tcp_ports[REPLAYER]) for one in plan.links.listening}
    access = {"tcp_ports": ports, "external": (), "address": "127.0.0.1", "addresses": {}}
    return changed(plan, access={**access, "namespace": plan.run_id})
