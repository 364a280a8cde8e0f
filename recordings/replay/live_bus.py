"""The bus as live controllers see it: one session in place of all other agents."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import msgspec
import zenoh

from agents.machine import MachineSettings
from agents.plan import RunPlan
from bus_schemas.codec import decode
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import REPLAYER
from bus_schemas.zenoh_bus import Inbox
from launch_scripts.launcher.supervision import RunFailure
from recordings.read.gaps import due_step
from recordings.replay.bus import ReplayBus


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
    return msgspec.structs.replace(
        plan,
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
