"""Wiring of a run: publisher, listeners and key of each port, and links between processes.

All of it follows from the table of signals. A key is `<plant>/<path of the node>/<signal>`; a Zenoh
session adds the run's namespace before it. Zenoh peers do not relay, so each pair that talks needs
a link of its own (see docs/decisions/0002-explicit-links.md).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import msgspec

from bus_schemas.messages import Message
from bus_schemas.signals import COMMAND, TELEMETRY, Port, Signal, listeners, ports
from bus_schemas.tree import (
    OPERATOR,
    RECORDER,
    ControlTree,
    ancestors,
    common_ancestor,
)

_BUNDLED: Final = frozenset({TELEMETRY, COMMAND})
"""Signals whose messages travel in bundles between plant and group."""


@dataclass(frozen=True, eq=False)
class Bundle:
    """Messages that travel as one: what a group says to itself, or exchanges with the plant.

    Its payload is an array of pairs: the key of a message without the plant's name, the message.

    key: Without the plant's name.
    source, sinks: Processes that send it, and that hear it besides the recorder.
    ports: By key, those whose messages it may hold.
    """

    key: str
    source: str
    sinks: tuple[str, ...]
    ports: dict[str, Port[Message]]

    def __str__(self) -> str:
        return self.key

    @property
    def signal(self) -> Signal[Message]:
        """The signal of all messages, where another process hears them."""
        return next(iter(self.ports.values())).signal

    def messages(self, payload: bytes) -> list[tuple[Port[Message], Message]]:
        """Return the messages in a payload, with their ports, or raise one of `UNREADABLE`."""
        try:
            return [(self.ports[key], one) for key, one in self.signal.decode_bundle(payload)]
        except KeyError as error:
            raise msgspec.DecodeError(f"{self} holds no {error}") from None


class Wiring:
    """The wiring of a run: a table of ports, each with its publisher and its listeners.

    process_of: The process of each agent that shares one; the others have one of their own name.
    devices: Agents that are not ours. If the operator is not one, nobody may publish orders.

    members: Agents of each process.
    listeners: Agents that hear each port.
    heard: Ports that each agent hears.
    """

    def __init__(
        self,
        plant: str,
        tree: ControlTree,
        process_of: Mapping[str, str] | None = None,
        devices: Collection[str] = (),
    ) -> None:
        self.plant = plant
        self._devices, has_operator = frozenset(devices), OPERATOR in devices
        self._tree = tree
        self.ports = tuple(
            port for port in ports(tree) if has_operator or port.publisher != OPERATOR
        )
        self.listeners = {
            port: listeners(port, tree, has_operator=has_operator) for port in self.ports
        }
        operator = (OPERATOR,) if has_operator else ()
        self.heard: dict[str, list[Port[Message]]] = {
            name: [] for name in (*tree.agents(), *operator)
        }
        for port, names in self.listeners.items():
            for name in names:
                self.heard[name].append(port)
        self._port_of = {self.key(port): port for port in self.ports}
        self._process_of = process_of or {}
        self.members: dict[str, list[str]] = {}
        for name in self.heard:
            self.members.setdefault(self.process_of(name), []).append(name)
        self.bundles = self._bundles()

    def process_of(self, name: str) -> str:
        return self._process_of.get(name, name)

    @cached_property
    def carried(self) -> dict[tuple[str, str], list[Port[Message]]]:
        """The ports that a process publishes and another hears, by pair. The recorder hears all."""
        found: dict[tuple[str, str], list[Port[Message]]] = {}
        for port, hearers in self.listeners.items():
            source = self.process_of(port.publisher)
            if source in self.members:
                for sink in {RECORDER, *map(self.process_of, hearers)} - {source}:
                    found.setdefault((source, sink), []).append(port)
        return found

    def _bundles(self) -> tuple[Bundle, ...]:
        """Return the bundles. Their sinks also hear each of the messages by itself."""
        found: dict[str, Bundle] = {}
        for port, hearers in self.listeners.items():
            source = self.process_of(port.publisher)
            sinks = tuple({*map(self.process_of, hearers)} - {source})
            ends = source, *sinks
            groups = [end for end in ends if len(self.members.get(end, ())) > 1]
            travels_so = port.signal in _BUNDLED if sinks else port.signal.is_cyclic
            if groups and travels_so and self._devices.isdisjoint(ends):
                key = f"{groups[0]}/{port.signal.name}_bundle" if sinks else f"{source}/bundle"
                bundle = found.setdefault(key, Bundle(key, source, sinks, {}))
                bundle.ports[str(port)] = port
        return tuple(found.values())

    def key(self, port: Port[Message] | Bundle) -> str:
        return f"{self.plant}/{port}"

    def port(self, key: str) -> Port[Message] | None:
        return self._port_of.get(key)

    def key_exprs(self, ports: Iterable[Port[Message]], least: int = 2) -> list[str]:
        """Return key expressions that match these ports and no others.

        From `least` ports of a signal on, they share one expression: for all nodes at or below a
        node, for its children, or for all below it.
        """
        of_signal: dict[Signal[Message], list[Port[Message]]] = {}
        for port in ports:
            of_signal.setdefault(port.signal, []).append(port)
        found: list[str] = []
        for signal, some in of_signal.items():
            nodes = {port.node for port in some}
            common = self._wildcard(signal, nodes) if len(nodes) >= least else None
            found += [common] if common else map(self.key, some)
        return found

    def bundle_exprs(self, bundles: Collection[Bundle], least: int) -> list[str]:
        if len(bundles) < least:
            return [self.key(bundle) for bundle in bundles]
        return [*dict.fromkeys(f"{self.plant}/**/{one.signal.name}_bundle" for one in bundles)]

    def _wildcard(self, signal: Signal[Message], nodes: set[str]) -> str | None:
        """Return one key expression for a signal of exactly these nodes, if there is one."""
        top, below = common_ancestor(nodes), self._below[signal]
        start = f"{self.plant}/{top}/" if top else f"{self.plant}/"
        if len(nodes) == below[top]:
            return f"{start}**/{signal.name}"
        if nodes == {*self._tree.children(top)}:
            return f"{start}*/{signal.name}"
        if top not in nodes and len(nodes) == below[top] - 1:
            return f"{start}*/**/{signal.name}"
        return None

    @cached_property
    def _below(self) -> dict[Signal[Message], Counter[str]]:
        """How many ports each signal has at or below each node."""
        found: dict[Signal[Message], Counter[str]] = {}
        for port in self.ports:
            found.setdefault(port.signal, Counter()).update((port.node, *ancestors(port.node)))
        return found

    def alive_key(self, process: str) -> str:
        """Return the key of a process's liveliness token: one for all its agents."""
        return f"{self.plant}/{process}/alive"

    def links(self) -> Links:
        """Return a link for each pair of processes of which one publishes what the other hears."""
        processes = [*self.members]
        rank = {process: number for number, process in enumerate(processes)}
        pairs = sorted({tuple(sorted((rank[one], rank[other]))) for one, other in self.carried})
        return Links(tuple((processes[top], processes[below]) for top, below in pairs))


@dataclass(frozen=True)
class Links:
    """The links of a run, or some of them.

    pairs: (listening process, connecting process). The one nearer to the top of the list of agents
        listens, so that few ports are needed and no inverter needs one.
    """

    pairs: tuple[tuple[str, str], ...]

    @cached_property
    def listening(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(listener for listener, _ in self.pairs))

    def endpoints(
        self, agent: str, endpoint_of: Callable[[str], str]
    ) -> tuple[list[str], list[str]]:
        tops = [top for top, below in self.pairs if below == agent]
        listens = [endpoint_of(agent)] if agent in self.listening else []
        return listens, [endpoint_of(top) for top in tops]

    def peers(self, agent: str) -> tuple[str, ...]:
        linked = [pair for pair in self.pairs if agent in pair]
        return tuple(below if top == agent else top for top, below in linked)
