"""The bus of live controllers among recorded agents.

The other agents do what they did, whatever the live ones publish: the loop is open. In lockstep a
cycle begins when the live controllers have finished the earlier ones. In real time every message
goes out at its recorded time, and the live controllers have their deadlines.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from itertools import count
from typing import Final

from msgspec.structs import replace

from agents.cycle import stage_of
from agents.plan import RunPlan, changed
from agents.process.interruption import Interruption
from agents.process.machine import MachineSettings
from bus_schemas.codec import decode, encode
from bus_schemas.errors import listed
from bus_schemas.messages import Message, Run
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import REPLAYER, ROOT, ControlTree
from launch_scripts.supervision import Children, RunFailure
from recordings.read.gaps import due_step
from recordings.read.reader import RunReader
from recordings.replay.bus import ReplayBus
from recordings.verify.agent_result import AgentResult
from recordings.verify.equality import BIT_FOR_BIT
from sim_plant.plant_run import FIRST_ROUND, longest_round_s
from studies.live_replay.controllers import LiveControllers

_ARMING_S: Final = 30.0
_EARLY_CYCLES: Final = 100
"""Every agent publishes within so many first cycles, even if messages are lost."""


def live_plan(plan: RunPlan, live: Iterable[str], tcp_ports: dict[str, int], port: int) -> RunPlan:
    """Return the plan by which live controllers find each other, and all others at one TCP port.

    That port is of the `LiveBus`: every agent connects to the recorder, and so to it.
    """
    all_ports = dict.fromkeys(plan.links.listening, port)
    all_ports.update({agent: tcp_ports[agent] for agent in live if agent in all_ports})
    return changed(
        plan.public,
        access={
            "tcp_ports": all_ports,
            "namespace": "",
            "external": (),
            "address": "127.0.0.1",
            "addresses": {},
        },
        faults={"rules": ()},
        supervision={"machine": MachineSettings()},
    )


class MessagePairs:
    """The recorded and the new messages of some agents, and the result of each agent."""

    def __init__(self, tree: ControlTree, agents: Iterable[str]) -> None:
        self.results = {agent: AgentResult() for agent in agents}
        self._tree = tree
        self._waiting: dict[tuple[Port[Message], int, bool], Message] = {}

    def take(self, port: Port[Message], message: Message, *, is_recorded: bool) -> None:
        """Compare a message with its counterpart, now or when that comes."""
        self.results[port.publisher].recorded += is_recorded
        other = self._waiting.pop((port, message.cycle, not is_recorded), None)
        if other is None:
            self._waiting[port, message.cycle, is_recorded] = message
        elif is_recorded:
            self._compare(port, message, other)
        else:
            self._compare(port, other, message)

    def finish(self, before_cycle: int) -> None:
        """Count the messages without a counterpart in the cycles before one."""
        for (port, cycle, is_recorded), message in self._waiting.items():
            if cycle < before_cycle:
                self._compare(port, *((message, None) if is_recorded else (None, message)))

    def _compare(self, port: Port[Message], recorded: Message | None, new: Message | None) -> None:
        stage = stage_of(port, self._tree)
        self.results[port.publisher].compare(BIT_FOR_BIT, port, recorded, new, stage)


class LiveBus(ReplayBus):
    """Gives live controllers the messages of the others, observers those of all, and compares.

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
        others = [port for port in plan.wiring.ports if port.publisher not in {REPLAYER, *live}]
        super().__init__(plan, others, f"tcp/127.0.0.1:{tcp_port}")
        self.pairs = MessagePairs(plan.tree, live)
        self.cycles = 0
        self._observers = observers
        self._live = LiveControllers(plan, live, children, interruption, self._take_new)
        self._subscribers = self._live.subscribe(self.session)

    def arm(self, reader: RunReader) -> None:
        """Send arming rounds until the live controllers are there and answer a whole one.

        In a round the other agents publish what they published first in the run.
        """
        first = self._first_messages(reader)
        give_up_at = time.monotonic() + _ARMING_S
        for number in count(1):
            cycle = FIRST_ROUND + number
            sim_time_ns = self._plan.timing.sim_time_ns(cycle)
            for port, message in first.items():
                stamped = replace(message, cycle=cycle, sim_time_ns=sim_time_ns, missing=())
                super().put(port, encode(stamped))
            silent = self._live.await_cycle(cycle, longest_round_s(number))
            if not silent:
                return
            if self._live.interruption:
                raise KeyboardInterrupt
            if time.monotonic() > give_up_at:
                names = listed(sorted(map(str, silent)))
                raise RunFailure(f"no arming round closed: nothing came on {names}")

    def put(self, port: Port[Message], payload: bytes) -> bool:
        """Take in a recorded message; return whether it was sent as it is."""
        if port.signal is RUN:
            run = decode(RUN, payload)
            if run.state == "start":
                lead_ns = run.start_time_ns - run.publish_time_ns
                self._publish_run(replace(run, start_time_ns=time.monotonic_ns() + lead_ns))
            return False
        if port.publisher in self._live.names:
            self.pairs.take(port, decode(port.signal, payload), is_recorded=True)
            return False
        self._observers.put(port, payload)
        return super().put(port, payload)

    def announce(self, cycle: int, *, rate: float, paused: bool) -> None:
        """Begin a cycle; in lockstep, wait until no live controller is too far behind."""
        # One agent may be some cycles ahead of another.
        self._complete(cycle - self._plan.control.periods.longest)
        self._observers.announce(cycle, rate=rate, paused=paused)

    def listen(self, seconds: float) -> None:
        """Take in what the live controllers publish, until something has come or a time is over."""
        self._live.receive(1, seconds)

    def finish(self) -> None:
        """End the run, unless the user did, and compare what is left."""
        self._complete(self._plan.timing.cycles)
        if not self._live.interruption:
            self._publish_run(self._plan.run_message("stop", self.cycles, 0))
            self._live.receive_the_last()
        self.pairs.finish(self.cycles)

    def _first_messages(self, reader: RunReader) -> dict[Port[Message], Message]:
        """Return the first message of each port on which the others publish in every cycle."""
        others = (
            port for port in self._plan.wiring.ports if port.publisher not in self._live.names
        )
        wanted = {port for port in others if due_step(self._plan, port)}
        first: dict[Port[Message], Message] = {}
        for port, message in reader.on(wanted, range(_EARLY_CYCLES)):
            first.setdefault(port, message)
            if len(first) == len(wanted):
                break
        return first

    def _complete(self, cycles: int) -> None:
        """Go on to some number of cycles: in lockstep, wait until they are over."""
        while self.cycles < cycles and not self._live.interruption:
            # The live controllers themselves report what they wait for.
            patience_s = self._plan.timing.stall_timeout_s + 1.0
            if self._plan.timing.lockstep and self._live.await_cycle(self.cycles, patience_s):
                if self._live.interruption:
                    return
                raise self._live.stall(self.cycles)
            self.cycles += 1

    def _take_new(self, port: Port[Message], message: Message, payload: bytes) -> None:
        self._observers.put(port, payload)
        self.pairs.take(port, message, is_recorded=False)

    def _publish_run(self, run: Run) -> None:
        """Publish to all that the run begins or ends."""
        port = RUN.of(ROOT)
        self._outbox.stamp(port, run, time.monotonic_ns())
        for put in (super().put, self._observers.put):
            put(port, encode(run))
