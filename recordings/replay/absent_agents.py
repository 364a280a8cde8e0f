"""Takes the place of all agents of a run but the live ones, in one session on the bus."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import NamedTuple

import msgspec
import zenoh

from agents.machine import MachineSettings
from agents.plan import RunPlan
from bus_schemas.codec import decode
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port
from bus_schemas.tree import CENTRAL, REPLAYER, ROOT
from bus_schemas.zenoh_bus import ENCODING, Inbox, SessionSettings, open_session
from launch_scripts.launcher.supervision import RunFailure


class Heard(NamedTuple):
    """A message of a live agent, as bytes and decoded."""

    port: Port[Message]
    message: Message
    payload: bytes


class AbsentAgents:
    """All agents but the live ones, as the live ones see them.

    Parameters
    ----------
    plan
        Of the live agents, see `live_plan`.
    live
        Names of the live agents.
    tcp_port
        Where it listens.
    """

    def __init__(self, plan: RunPlan, live: Collection[str], tcp_port: int) -> None:
        self._keys = keys = plan.keys
        self._live = frozenset(live)
        self._inbox = Inbox()
        endpoint = f"tcp/127.0.0.1:{tcp_port}"
        self._session = open_session(SessionSettings(plan.bus_namespace, [endpoint], []))
        # Whom nobody hears live is only put on the observers' session.
        self._put = {
            port: self._declare(keys.key(port)).put
            for port in keys.ports
            if port.publisher not in self._live and port.publisher != REPLAYER
        }
        self._subscribers = [
            self._session.declare_subscriber(
                keys.key(port),
                zenoh.handlers.Callback(self._inbox.callback(port), indirect=False),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for port in keys.ports
            if port.publisher in self._live
        ]
        self._tokens = [
            self._session.liveliness().declare_token(keys.alive_key(agent))
            for agent in plan.tree.agents()
            if agent not in self._live
        ]

    def put(self, port: Port[Message], payload: bytes) -> None:
        """Send bytes in the name of an agent. Waits for a live agent that has fallen behind."""
        self._put[port](payload)

    def receive(self, wanted: int, timeout_s: float) -> list[Heard]:
        """Return what the live agents have sent, once so much is there or at the time-out.

        Raises
        ------
        RunFailure
            One of them sent what is no message of the run.
        """
        heard = []
        for port, payload, _ in self._inbox.take(wanted, timeout_s):
            data = payload.to_bytes()
            try:
                heard.append(Heard(port, decode(port.signal, data), data))
            except msgspec.DecodeError as error:
                raise RunFailure(
                    f"{port}: a live agent's message does not decode: {error}"
                ) from None
        return heard

    def not_there(self) -> list[str]:
        """Return the live agents whose liveliness token is not seen."""
        replies = self._session.liveliness().get(self._keys.alive_key("**"), timeout=1.0)
        seen = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        return sorted(agent for agent in self._live if self._keys.alive_key(agent) not in seen)

    def __enter__(self) -> AbsentAgents:
        return self

    def __exit__(self, *error: object) -> None:
        # An open session can hang the interpreter's exit.
        self._session.close()

    def _declare(self, key: str) -> zenoh.Publisher:
        return self._session.declare_publisher(
            key,
            encoding=ENCODING,
            congestion_control=zenoh.CongestionControl.BLOCK,
            reliability=zenoh.Reliability.RELIABLE,
        )


def live_plan(
    plan: RunPlan, live: Iterable[str], tcp_ports: dict[str, int], absent_port: int
) -> RunPlan:
    """Return the plan by which live agents find each other, and all others at one port.

    Parameters
    ----------
    plan
        Of the run.
    live
        Names of the live agents.
    tcp_ports
        Port on 127.0.0.1 of each agent that listens, live ones at least.
    absent_port
        Port of the absent agents. Each agent connects to the recorder, so each connects to it.
    """
    everybody = dict.fromkeys(plan.links.listening, absent_port)
    for agent in live:
        if agent in everybody:
            everybody[agent] = tcp_ports[agent]
    return msgspec.structs.replace(
        plan, tcp_ports=everybody, namespace="", external=(), faults=(), machine=MachineSettings()
    )


def steady_ports(plan: RunPlan, agents: Collection[str], cycle: int) -> set[Port[Message]]:
    """Return the ports on which agents must publish in a cycle, whatever they decide."""
    found = set()
    for port in plan.keys.ports:
        if port.publisher not in agents:
            continue
        occurrence = port.signal.occurrence
        node = ROOT if port.publisher == CENTRAL else port.publisher
        if occurrence is Occurrence.CYCLE or (
            occurrence is Occurrence.TURN and plan.periods.is_turn(node, cycle)
        ):
            found.add(port)
    return found
