"""Takes the place of everybody in a run but a few live agents, in one session on the bus."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import NamedTuple

import msgspec
import zenoh

from agents.machine import MachineSettings
from agents.plan import RunPlan
from bus_schemas.codec import decode, encode
from bus_schemas.links import explicit_links
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port, ports
from bus_schemas.tree import CENTRAL, REPLAYER, ROOT
from bus_schemas.zenoh_bus import ENCODING, Inbox, SessionSettings
from launch_scripts.supervision import RunFailure


class Heard(NamedTuple):
    """A message of a live agent, as bytes and decoded."""

    port: Port[Message]
    message: Message
    payload: bytes


class StandIn:
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
        self._plan = plan
        self._live = frozenset(live)
        self._inbox = Inbox()
        settings = SessionSettings(plan.bus_namespace, [f"tcp/127.0.0.1:{tcp_port}"], [])
        self._session = zenoh.open(settings.config())
        self._put = {port: self._declare(port).put for port in ports(plan.tree) if self._is(port)}
        self._subscriber = self._session.declare_subscriber(
            f"{plan.plant}/**", self._inbox.put, allowed_origin=zenoh.Locality.REMOTE
        )
        self._tokens = [
            self._session.liveliness().declare_token(plan.keys.alive_key(agent))
            for agent in plan.tree.agents()
            if agent not in self._live
        ]

    def put(self, port: Port[Message], payload: bytes) -> None:
        """Send bytes in the name of an agent. Waits for a live agent that has fallen behind."""
        self._put[port](payload)

    def publish(self, port: Port[Message], message: Message) -> None:
        """Send a message in the name of an agent."""
        self.put(port, encode(message))

    def receive(self, wanted: int, timeout_s: float) -> list[Heard]:
        """Return what the live agents have sent, once so much is there or at the time-out.

        Raises
        ------
        RunFailure
            One of them sent what is no message of the run.
        """
        return [
            self._unpack(str(sample.key_expr), sample.payload.to_bytes())
            for _, sample in self._inbox.take(wanted, timeout_s)
        ]

    def absent(self) -> list[str]:
        """Return the live agents whose liveliness token is not seen."""
        pattern = f"{self._plan.plant}/**/alive"
        replies = self._session.liveliness().get(pattern, timeout=1.0)
        seen = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        return sorted(agent for agent in self._live if self._plan.keys.alive_key(agent) not in seen)

    def __enter__(self) -> StandIn:
        return self

    def __exit__(self, *error: object) -> None:
        # An open session can hang the interpreter's exit.
        self._session.close()

    def _is(self, port: Port[Message]) -> bool:
        return port.publisher not in self._live and port.publisher != REPLAYER

    def _declare(self, port: Port[Message]) -> zenoh.Publisher:
        return self._session.declare_publisher(
            self._plan.keys.key(port),
            encoding=ENCODING,
            congestion_control=zenoh.CongestionControl.BLOCK,
            reliability=zenoh.Reliability.RELIABLE,
        )

    def _unpack(self, key: str, payload: bytes) -> Heard:
        port = self._plan.keys.port(key)
        try:
            if port is None:
                raise RunFailure(f"{key}: a live agent sent what this run does not have")
            return Heard(port, decode(port.signal, payload), payload)
        except msgspec.DecodeError as error:
            raise RunFailure(f"{key}: what a live agent sent does not decode: {error}") from None


def live_plan(
    plan: RunPlan, live: Iterable[str], tcp_ports: dict[str, int], stand_in_port: int
) -> RunPlan:
    """Return the plan by which live agents find each other, and the stand-in for all others.

    Parameters
    ----------
    plan
        Of the run.
    live
        Names of the live agents.
    tcp_ports
        Port on 127.0.0.1 of each agent that listens, live ones at least.
    stand_in_port
        Port of the stand-in. Each agent connects to the recorder, so each connects to it.
    """
    everybody = dict.fromkeys(explicit_links(plan.tree).listening, stand_in_port)
    for agent in live:
        if agent in everybody:
            everybody[agent] = tcp_ports[agent]
    return msgspec.structs.replace(
        plan, tcp_ports=everybody, namespace="", external=(), machine=MachineSettings()
    )


def steady_ports(plan: RunPlan, live: Collection[str], cycle: int) -> set[Port[Message]]:
    """Return the ports on which live agents must publish in a cycle, whatever they decide."""
    found = set()
    for port in ports(plan.tree):
        if port.publisher not in live:
            continue
        occurrence = port.signal.occurrence
        node = ROOT if port.publisher == CENTRAL else port.publisher
        if occurrence is Occurrence.CYCLE or (
            occurrence is Occurrence.TURN and plan.periods.is_turn(node, cycle)
        ):
            found.add(port)
    return found
