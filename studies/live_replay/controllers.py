"""The live controllers of a replay: their processes, and what they publish."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Final

import msgspec
import zenoh

from agents.plan import RunPlan
from agents.process.interruption import Interruption
from bus_schemas.codec import decode
from bus_schemas.inbox import Inbox
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.supervision import Children, RunFailure, stall
from recordings.read.gaps import due_step
from sim_plant.plant_run import FIRST_ROUND

_LOOK_S: Final = 0.1
"""How often the processes are checked."""

_END_S: Final = 5.0
"""How long the live controllers may take to end after the run."""


class LiveControllers:
    """The processes of some controllers, and what they publish.

    `on_message` is called with each message of the run, and with its payload.
    """

    def __init__(
        self,
        plan: RunPlan,
        names: Collection[str],
        children: Children,
        interruption: Interruption,
        on_message: Callable[[Port[Message], Message, bytes], None],
    ) -> None:
        self.names = names
        self.interruption = interruption
        self._children = children
        self._on_message = on_message
        self._key = plan.wiring.key
        self._tree = plan.tree
        self._inbox = Inbox()
        self._ports = [port for port in plan.wiring.ports if port.publisher in names]
        self._steps = {port: step for port in self._ports if (step := due_step(plan, port))}
        self._newest: dict[Port[Message], int] = {}
        self._received = 0
        self._look_at = 0.0

    def subscribe(self, session: zenoh.Session) -> list[object]:
        """Return the subscribers to all that the controllers publish; they end with the session."""
        return [
            session.declare_subscriber(
                self._key(port),
                zenoh.handlers.Callback(self._inbox.callback(port), indirect=False),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for port in self._ports
        ]

    def receive(self, wanted: int, timeout_s: float) -> int:
        """Take in what is published within a time; return how many messages came."""
        arrivals = self._inbox.take(wanted, timeout_s)
        for port, received, _ in arrivals:
            payload = received.to_bytes()
            try:
                message = decode(port.signal, payload)
            except msgspec.DecodeError as error:
                expected = port.signal.type.__name__
                raise RunFailure(f"{port}: expected a {expected}, got: {error}") from None
            self._newest[port] = message.cycle
            if message.cycle >= 0:
                self._received += 1
                self._on_message(port, message, payload)
        if time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LOOK_S
            self._children.events(0.0)
        return len(arrivals)

    def await_cycle(self, cycle: int, patience_s: float) -> set[Port[Message]]:
        """Wait for all that is due in a cycle, or in an arming round.

        Returns the ports on which nothing came, though nothing else came for a time either.
        """
        awaited = {port for port, step in self._steps.items() if cycle < 0 or cycle % step == 0}
        until = time.monotonic() + patience_s
        while awaited := {p for p in awaited if self._newest.get(p, FIRST_ROUND) < cycle}:
            if self.receive(len(awaited), _LOOK_S):
                until = time.monotonic() + patience_s
            if self.interruption or time.monotonic() > until:
                break
        return awaited

    def stall(self, cycle: int) -> RunFailure:
        """Return why a cycle does not end: the controllers say what they wait for."""
        is_known = any(child.waiting for child in self._children)
        return RunFailure(
            stall(self._children, self._tree)[0] if is_known else f"stalled in cycle {cycle}"
        )

    def receive_the_last(self) -> None:
        """Let the controllers end, and receive all that they have sent."""
        if late := self._children.await_exit(list(self._children), _END_S):
            agent = late[0].agent
            raise self._children.failure(agent, f"{agent} did not end with the run")
        ended = [child.finished for child in self._children if child.finished is not None]
        sent = sum(sum(finished.published.values()) for finished in ended)
        until = time.monotonic() + _END_S
        while self._received < sent and time.monotonic() < until:
            self.receive(sent - self._received, _LOOK_S)
