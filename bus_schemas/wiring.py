"""Who publishes and hears what in a run, under which key, and who is linked with whom.

All of it follows from the table of signals. A key is `<plant>/<path of the node>/<signal>`; a Zenoh
session adds the run's namespace before it. Zenoh peers do not relay, so each pair that talks needs
a link of its own (see docs/decisions/0002-explicit-links.md).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port, listeners, ports
from bus_schemas.tree import OPERATOR, RECORDER, ControlTree, agent_of, standby_of


class Wiring:
    """The wiring of a run.

    listeners, processes: Agents, and with them standbys, that hear each port.
    has_operator: Whether the operator is a program on the bus; else nobody may publish orders.
    published, heard: Ports of each agent.
    last_ports: Of an agent with a standby: its last port in each cycle, and in each of its turns.
        Its two processes hear them from each other.
    """

    def __init__(
        self,
        plant: str,
        tree: ControlTree,
        standbys: Collection[str] = (),
        *,
        has_operator: bool = False,
    ) -> None:
        self.plant = plant
        self.ports = tuple(
            port for port in ports(tree) if has_operator or port.publisher != OPERATOR
        )
        self.listeners = {
            port: listeners(port, tree, has_operator=has_operator) for port in self.ports
        }
        self.published: dict[str, list[Port[Message]]] = {}
        self.heard: dict[str, list[Port[Message]]] = {}
        self.last_ports: dict[str, tuple[Port[Message], ...]] = {}
        for port, names in self.listeners.items():
            self.published.setdefault(port.publisher, []).append(port)
            for name in names:
                self.heard.setdefault(name, []).append(port)
        self.processes = dict(self.listeners)
        for agent in standbys:
            last = {port.signal.occurrence: port for port in self.published[agent]}
            self.last_ports[agent] = (last[Occurrence.CYCLE], last[Occurrence.TURN])
            self.heard[agent] += self.last_ports[agent]
            for port in self.heard[agent]:
                own = (agent,) if port in self.last_ports[agent] else ()
                self.processes[port] += (*own, standby_of(agent))
        self._port_of = {self.key(port): port for port in self.ports}
        operator = (OPERATOR,) if has_operator else ()
        self._processes = (*tree.agents(), *map(standby_of, standbys), *operator)

    def key(self, port: Port[Message]) -> str:
        return f"{self.plant}/{port}"

    def port(self, key: str) -> Port[Message] | None:
        """Port that a key names, None if there is none."""
        return self._port_of.get(key)

    def alive_key(self, agent: str) -> str:
        return f"{self.plant}/{agent}/alive"

    def links(self) -> Links:
        """Return a link for each pair of processes of which one publishes what the other hears."""
        rank = {process: number for number, process in enumerate(self._processes)}
        pairs = {(RECORDER, process) for process in self._processes if process != RECORDER}
        for port, hearers in self.processes.items():
            for source in {port.publisher, standby_of(port.publisher)} & rank.keys():
                for sink in {*hearers} - {source}:
                    # A standby is as near to the top as its agent, and comes after it.
                    top, below = sorted((source, sink), key=lambda one: (rank[agent_of(one)], one))
                    pairs.add((top, below))
        return Links(tuple(sorted(pairs, key=lambda pair: (rank[pair[0]], rank[pair[1]]))))


@dataclass(frozen=True)
class Links:
    """The TCP links of a run, or some of them.

    pairs: (listening process, connecting process). The one nearer to the top of the list of agents
        listens, so that few ports are needed and no inverter needs one.
    """

    pairs: tuple[tuple[str, str], ...]

    @cached_property
    def listening(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(listener for listener, _ in self.pairs))

    def endpoints(
        self,
        agent: str,
        tcp_ports: Mapping[str, int],
        host_of: Callable[[str], str] = lambda agent: "tcp/127.0.0.1",
    ) -> tuple[list[str], list[str]]:
        tops = [top for top, below in self.pairs if below == agent]
        listens = [f"{host_of(agent)}:{tcp_ports[agent]}"] if agent in self.listening else []
        return listens, [f"{host_of(top)}:{tcp_ports[top]}" for top in tops]

    def peers(self, agent: str) -> tuple[str, ...]:
        linked = [pair for pair in self.pairs if agent in pair]
        return tuple(below if top == agent else top for top, below in linked)
