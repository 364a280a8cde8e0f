"""The one table of signals. Keys, subscriptions, links, channels and schemas are derived from it.

A signal is always *about* one node of the control tree, and that node's path stands in its key:
`oahu/c2/inv07/setpoint` is the setpoint OF `c2/inv07` (given by its parent), `oahu/c2/inv07/impp`
is the IMPP that `c2/inv07` states itself. The table says for each signal about which nodes it exists,
who publishes it and who listens, both as seen from that node.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from types import GenericAlias
from typing import Any, Final, Generic, TypeVar

import msgspec

from bus_schemas import messages
from bus_schemas.messages import Message
from bus_schemas.tree import (
    CENTRAL,
    OPERATOR,
    PLANT,
    RECORDER,
    REPLAYER,
    ROOT,
    ControlTree,
    agent_name,
    parent_of,
)

M_co = TypeVar("M_co", bound=Message, covariant=True)


class About(Enum):
    """The nodes that a signal exists for."""

    DEVICES = "each inverter and storage"
    CHILDREN = "each node but the root"
    NODES = "each node"
    PLANT = "the plant as a whole"
    METERS = "the plant as a whole, and each plant of a fleet"


class Role(Enum):
    """An agent, as seen from the node that a signal is about."""

    NODE = "its node"
    PARENT = "parent"
    PLANT = "plant"
    CENTRAL = "central"
    RECORDER = "recorder"
    REPLAYER = "replay"
    OPERATOR = "operator"
    CONTROLLERS = "controllers"


class Occurrence(Enum):
    """How often a signal comes."""

    CYCLE = "each cycle"
    TURN = "each turn of its publisher"
    NEED = "when needed"
    EVENT = "rarely"
    REPLAY = "only in a replay"


_CYCLIC: Final = frozenset({Occurrence.CYCLE, Occurrence.TURN, Occurrence.NEED})


@dataclass(frozen=True, eq=False)
class Signal(Generic[M_co]):
    """One row of the table.

    logged: Whether the recorder keeps it.
    decided: Whether an agent decides it, so that the same inputs give it again, or its process.
    hop_p99_ms: Timing budget on one host: from publishing to arrival at a listener, 99 of 100
        messages [ms]. None: no budget, since no stage waits for it last.
    """

    name: str
    type: type[M_co]
    about: About
    publisher: Role
    listeners: tuple[Role, ...]
    occurrence: Occurrence
    logged: bool = True
    decided: bool = True
    hop_p99_ms: float | None = None
    _ports: dict[str, Port[M_co]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def decode(self) -> Callable[[bytes], M_co]:
        """Returns the message of a payload, or raises one of `UNREADABLE`."""
        return msgspec.msgpack.Decoder(self.type).decode

    @cached_property
    def decode_bundle(self) -> Callable[[bytes], list[tuple[str, M_co]]]:
        """Returns keys and messages of a bundle of this signal, or raises likewise."""
        pairs: Any = GenericAlias(list, GenericAlias(tuple, (str, self.type)))
        decode: Callable[[bytes], list[tuple[str, M_co]]] = msgspec.msgpack.Decoder(pairs).decode
        return decode

    @property
    def is_cyclic(self) -> bool:
        """Whether it comes once in a cycle at most, and is about that cycle."""
        return self.occurrence in _CYCLIC

    def of(self, node: str) -> Port[M_co]:
        port = self._ports.get(node)
        if port is None:
            (publisher,) = _agents(self.publisher, node)
            port = self._ports[node] = Port(self, node, publisher)
        return port

    def nodes(self, tree: ControlTree) -> tuple[str, ...]:
        match self.about:
            case About.DEVICES:
                return tree.devices
            case About.CHILDREN:
                return tuple(node for node in tree.nodes if node != ROOT)
            case About.NODES:
                return tree.nodes
            case About.PLANT:
                return (ROOT,)
            case About.METERS:
                return tree.meters


@dataclass(frozen=True, eq=False)
class Port(Generic[M_co]):
    """One signal about one node: what a key names. `publisher` is the one agent that may use it.

    Get it from `Signal.of`: there is one object for each, so ports compare and hash by identity.
    """

    signal: Signal[M_co]
    node: str
    publisher: str

    def __str__(self) -> str:
        return f"{self.node}/{self.signal.name}" if self.node else self.signal.name


# fmt: off
TELEMETRY: Final  = Signal("telemetry",  messages.Telemetry,  About.DEVICES,  Role.PLANT,    (Role.NODE,),    Occurrence.CYCLE, hop_p99_ms=10.0)
DISPATCH: Final   = Signal("dispatch",   messages.Dispatch,   About.PLANT,    Role.PLANT,    (Role.CONTROLLERS, Role.OPERATOR), Occurrence.CYCLE)
METER: Final      = Signal("meter",      messages.Meter,      About.METERS,   Role.PLANT,    (Role.NODE, Role.OPERATOR), Occurrence.CYCLE)
IMPP: Final       = Signal("impp",       messages.Impp,       About.NODES,    Role.NODE,     (Role.PARENT,),  Occurrence.CYCLE)
RESIDUAL: Final   = Signal("residual",   messages.Residual,   About.NODES,    Role.NODE,     (Role.PARENT,),  Occurrence.CYCLE, hop_p99_ms=10.0)
HELP: Final       = Signal("help",       messages.Help,       About.NODES,    Role.NODE,     (),              Occurrence.NEED)
SETPOINT: Final   = Signal("setpoint",   messages.Setpoint,   About.CHILDREN, Role.PARENT,   (Role.NODE,),    Occurrence.TURN,  hop_p99_ms=10.0)
COMMAND: Final    = Signal("command",    messages.Command,    About.DEVICES,  Role.NODE,     (Role.PLANT,),   Occurrence.CYCLE, hop_p99_ms=10.0)
PRODUCTION: Final = Signal("production", messages.Production, About.PLANT,    Role.PLANT,    (),              Occurrence.CYCLE)
NOTICE: Final     = Signal("notice",     messages.Notice,     About.NODES,    Role.NODE,     (),              Occurrence.EVENT)
RUN: Final        = Signal("run",        messages.Run,        About.PLANT,    Role.PLANT,    (Role.CONTROLLERS, Role.OPERATOR), Occurrence.EVENT, decided=False)
READY: Final      = Signal("ready",      messages.Ready,      About.PLANT,    Role.RECORDER, (Role.PLANT,),   Occurrence.EVENT, logged=False, decided=False)
CLOCK: Final      = Signal("clock",      messages.Clock,      About.PLANT,    Role.REPLAYER, (),              Occurrence.REPLAY, logged=False, decided=False)
GIVEN_UP: Final   = Signal("given_up",   messages.GivenUp,    About.PLANT,    Role.PLANT,    (Role.CONTROLLERS,), Occurrence.EVENT, decided=False)
ORDER: Final      = Signal("order",      messages.Order,      About.PLANT,    Role.OPERATOR, (Role.PLANT,),   Occurrence.EVENT, decided=False)
OFFER: Final      = Signal("offer",      messages.Offer,      About.PLANT,    Role.CENTRAL,  (Role.PLANT,),   Occurrence.NEED)
MEMORY: Final     = Signal("memory",     messages.Memory,     About.METERS,   Role.NODE,     (Role.PLANT,),   Occurrence.CYCLE)

SIGNALS: Final[tuple[Signal[Message], ...]] = (
    TELEMETRY, DISPATCH, METER, IMPP, RESIDUAL, HELP, SETPOINT, COMMAND, PRODUCTION, NOTICE, RUN,
    READY, CLOCK, GIVEN_UP, ORDER, OFFER, MEMORY,
)
# fmt: on
"""The table itself. A new signal comes at the end: recordings number their channels in this order."""

_NAMES: Final = {
    Role.PLANT: PLANT,
    Role.CENTRAL: CENTRAL,
    Role.RECORDER: RECORDER,
    Role.REPLAYER: REPLAYER,
    Role.OPERATOR: OPERATOR,
}


def listeners(
    port: Port[Message], tree: ControlTree, *, has_operator: bool = False
) -> tuple[str, ...]:
    """Return the agents that act on a port's messages; the recorder hears all.

    has_operator: Whether the operator is a program on the bus.
    """
    roles = [role for role in port.signal.listeners if has_operator or role is not Role.OPERATOR]
    return tuple(name for role in roles for name in _agents(role, port.node, tree))


def ports(tree: ControlTree) -> tuple[Port[Message], ...]:
    return tuple(signal.of(node) for signal in SIGNALS for node in signal.nodes(tree))


def _agents(role: Role, node: str, tree: ControlTree | None = None) -> tuple[str, ...]:
    match role:
        case Role.NODE:
            return (agent_name(node),)
        case Role.PARENT:
            # Above the root is the operator, which is no process and does not listen.
            return (agent_name(parent_of(node)),) if node != ROOT else ()
        case Role.CONTROLLERS:
            return tuple(map(agent_name, tree.nodes)) if tree is not None else ()
        case _:
            return (_NAMES[role],)
