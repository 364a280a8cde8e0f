"""A program that wants to take a plant over: it forges each signal of a run, to whoever listens."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import zenoh
from msgspec.structs import replace

from agents.plan import RunPlan
from bus_schemas.codec import encode
from bus_schemas.messages import Command, Dispatch, Impp, Message, Order, Setpoint, Telemetry
from bus_schemas.signals import ORDER, RUN, Port
from bus_schemas.tree import OPERATOR, ROOT
from bus_schemas.zenoh_session import SessionSettings

HEAD = (0, 0, "", ())
FORGED: dict[str, Message] = {
    "command": Command(*HEAD, alpha=1.0, power_kw=123.0),
    "impp": Impp(*HEAD, power_kw=123.0, stale_cycles=0),
    "telemetry": Telemetry(*HEAD, power_kw=123.0, alpha=1.0, limit_kw=123.0),
    "setpoint": Setpoint(*HEAD, power_kw=123.0, share_kw=0.0, help_given=()),
    "dispatch": Dispatch(
        *HEAD, power_kw=123.0, plant_rating_kw=1900.0, commitment_kw=0.0, regulation_kw=0.0
    ),
}
"""What decides of power."""


class Attacker:
    """A session linked with every agent of a run that listens."""

    def __init__(self, plan: RunPlan, stack: ExitStack) -> None:
        self.plan = plan
        self.heard: list[str] = []
        self._sessions = []
        for endpoint in map(plan.access.endpoint, plan.access.tcp_ports):
            config = SessionSettings(plan.bus_namespace, [], [endpoint]).config()
            session = stack.enter_context(zenoh.open(config))
            self._sessions.append(session)
            session.declare_subscriber(
                f"{plan.plant}/**",
                lambda sample: self.heard.append(str(sample.key_expr)),
                allowed_origin=zenoh.Locality.REMOTE,
            )

    def put(self, port: Port[Message], message: Message) -> None:
        """Send a message to everybody."""
        for session in self._sessions:
            session.put(self.plan.wiring.key(port), encode(message))

    def forge(self, cycle: int, spared: str = "") -> None:
        """Forge what decides of power in a cycle, but for one agent's, and give an order."""
        head = {"cycle": cycle, "sim_time_ns": self.plan.timing.sim_time_ns(cycle)}
        self.put(ORDER.of(ROOT), Order(**head, source=OPERATOR, missing=(), power_kw=123.0))
        for port in self.plan.wiring.ports:
            forged = FORGED.get(port.signal.name)
            if forged is not None and port.publisher != spared:
                self.put(port, replace(forged, **head, source=port.publisher))

    def stop_run(self, cycle: int) -> None:
        """Say in the plant's name that the run ends before a cycle."""
        self.put(RUN.of(ROOT), self.plan.run_message("stop", cycle, time.monotonic_ns()))


@contextmanager
def attacker_of(plan: RunPlan) -> Iterator[Attacker]:
    """An attacker, linked; it leaves at the end."""
    with ExitStack() as stack:
        attacker = Attacker(plan, stack)
        time.sleep(1.0)  # Links that are refused never come up: there is nothing to wait for.
        yield attacker
