"""Runs one agent as a process: its sequencer, a bus, the clock, and the line to the launcher."""

from __future__ import annotations

import gc
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Final, Generic, TypeVar

from agents.agent import Agent
from agents.deadlines import deadline_ns
from agents.lifeline import Finished, Lifeline, Waiting
from agents.plan import RunPlan
from agents.sequencer import Sequencer
from bus_schemas.bus import Delivery
from bus_schemas.links import explicit_links
from bus_schemas.messages import Message, Run
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import ROOT
from bus_schemas.zenoh_bus import SessionSettings, ZenohBus

S = TypeVar("S")

log = logging.getLogger(__name__)

_IDLE_S: Final = 0.5
"""How long to wait for a message before looking whether something else has changed."""


class DropLog:
    """Names dropped messages in the log: the first few of a kind, then more and more rarely."""

    def __init__(self) -> None:
        self.total = 0

    def __call__(self, text: str) -> None:
        """Count a drop, and log it if it is its turn."""
        self.total += 1
        if self.total <= 10 or self.total & (self.total - 1) == 0:
            log.warning("dropped (%d so far): %s", self.total, text)


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
    """

    def __init__(
        self,
        agent: Agent[S],
        plan: RunPlan,
        bus: ZenohBus,
        lifeline: Lifeline,
        drop_log: DropLog,
    ) -> None:
        self.agent = agent
        self.plan = plan
        self.bus = bus
        self.lifeline = lifeline
        self.sequencer = Sequencer(
            agent,
            plan.sim_time_ns,
            lockstep=plan.lockstep,
            horizon=plan.periods.longest,
            on_drop=drop_log,
        )
        self.sequencer.end_before(plan.cycles)
        self._stop_heard = False
        self._bystanders: dict[Port[Message], Callable[[Message], None]] = {}
        self.listen(RUN.of(ROOT), self._heed)
        self._start_time_ns: int | None = None
        self._deadlines_ns: dict[str, int] = {}

    def run(self) -> None:
        """Take the agent through the run, from arming to the plant's word that it is over."""
        watch = StallWatch(self)
        spare_the_collector()
        while not (self.sequencer.finished and self._stop_heard):
            self.turn()
        watch.stop()
        self.report()

    def report(self) -> None:
        """Tell the launcher what went out and what could not be used."""
        dropped = Counter(vars(self.sequencer.drops))
        dropped["undecodable"] = self.bus.undecodable
        dropped["unknown"] = self.bus.unknown
        self.lifeline.tell(
            Finished(
                published=dict(self.bus.published),
                dropped={cause: count for cause, count in dropped.items() if count},
                missing_inputs=self.sequencer.missing_inputs,
            )
        )

    def listen(self, port: Port[Message], hear: Callable[[Message], None]) -> None:
        """Let a port's messages go to a function: they are about the run, not for the agent."""
        self._bystanders[port] = hear

    def turn(self, longest_s: float = _IDLE_S) -> None:
        """Wait for messages or the deadline, whichever comes first, and act on them."""
        remaining_s = self._until_deadline_s()
        timeout_s = longest_s if remaining_s is None else min(longest_s, remaining_s)
        for port, message, _ in self.bus.receive(self.sequencer.wanted, timeout_s):
            bystander = self._bystanders.get(port)
            if bystander is not None and self.sequencer.is_genuine(port, message):
                bystander(message)
            elif bystander is not None:
                continue
            else:
                self.send(self.sequencer.accept(port, message))
        if not self.sequencer.finished and self._until_deadline_s() == 0.0:
            self.send(self.sequencer.close_stage())

    def send(self, outputs: list[Delivery]) -> None:
        """Publish what the agent decided."""
        for port, message in outputs:
            self.bus.publish(port, message)

    def begin(self, start_time_ns: int) -> None:
        """Begin cycle 0, in real time with deadlines that count from this monotonic time."""
        if not self.plan.lockstep:
            self._start_time_ns = start_time_ns
        if self.sequencer.cycle < 0:
            self.send(self.sequencer.enter(0))

    def _heed(self, message: Message) -> None:
        """Follow the plant's word on the beginning and the end of the run."""
        if not isinstance(message, Run):
            return
        if message.state == "stop":
            self.sequencer.end_before(message.cycle)
            self._stop_heard = True
        else:
            self.begin(message.start_time_ns)

    def _until_deadline_s(self) -> float | None:
        """Time left for the open stage, 0 if it is over, None if it has no deadline."""
        if self._start_time_ns is None or not self.sequencer.stage or self.sequencer.cycle < 0:
            return None
        stage = self.sequencer.stage
        if stage not in self._deadlines_ns:
            self._deadlines_ns[stage] = deadline_ns(
                self.agent.name, stage, self.plan.tree, self.plan.cycle_wall_ns
            )
        began_ns = self._start_time_ns + self.sequencer.cycle * self.plan.cycle_wall_ns
        left_ns = began_ns + self._deadlines_ns[stage] - time.monotonic_ns()
        return max(left_ns, 0) / 1e9


def spare_the_collector() -> None:
    """Keep the cyclic garbage collector off what lives as long as the process.

    Nothing in a cycle of control makes reference cycles: there is next to nothing to collect.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000)


class StallWatch:
    """Looks from a thread of its own whether an agent in lockstep goes on, and says if it does not.

    It needs a thread because the agent may hang where it publishes: to a listener that takes
    nothing any more.
    """

    def __init__(self, runtime: Runtime[S]) -> None:
        self._runtime = runtime
        self._stopped = threading.Event()
        if runtime.plan.lockstep:
            threading.Thread(target=self._watch, name="stall watch", daemon=True).start()

    def stop(self) -> None:
        """End the watch."""
        self._stopped.set()

    def _watch(self) -> None:
        seen: tuple[object, ...] = ()
        since = time.monotonic()
        told = False
        while not self._stopped.wait(0.1):
            now = self._snapshot()
            if now != seen:
                seen, since, told = now, time.monotonic(), False
            elif not told and time.monotonic() - since > self._runtime.plan.stall_timeout_s:
                told = self._tell()

    def _snapshot(self) -> tuple[object, ...]:
        sequencer = self._runtime.sequencer
        return sequencer.cycle, sequencer.stage, self._runtime.bus.publishing

    def _tell(self) -> bool:
        sequencer, bus = self._runtime.sequencer, self._runtime.bus
        needs = [(str(port), port.publisher) for port in sorted(sequencer.waiting_for, key=str)]
        blocked_on = str(bus.publishing or "")
        if sequencer.cycle < 0 or not (needs or blocked_on):
            return False
        self._runtime.lifeline.tell(Waiting(sequencer.cycle, sequencer.stage, needs, blocked_on))
        return True


def session_settings(plan: RunPlan, agent: str) -> SessionSettings:
    """Return how an agent of the plan joins the bus."""
    listen, connect = explicit_links(plan.tree).endpoints(agent, plan.tcp_ports)
    return SessionSettings(plan.run_id, listen, connect, lockstep=plan.lockstep)


def open_bus(plan: RunPlan, agent: str, drop_log: DropLog) -> ZenohBus:
    """Join the bus as an agent of the plan."""
    return ZenohBus(agent, plan.keys, plan.tree, session_settings(plan, agent), drop_log)
