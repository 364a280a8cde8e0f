"""Who must be linked with whom: derived from the table of signals.

Zenoh peers do not relay, so each pair that talks needs a link of its own (see
docs/decisions/0002-explicit-links.md for the alternatives, measured).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

from bus_schemas.signals import listeners, ports
from bus_schemas.tree import RECORDER, ControlTree, standby_of


@dataclass(frozen=True)
class Links:
    """The TCP links of a run.

    pairs: (listening agent, connecting agent), each pair of agents that talk once. The one nearer
        to the top of the list of agents listens, so that few ports are needed and no inverter needs
        one.
    """

    pairs: tuple[tuple[str, str], ...]

    @cached_property
    def listening(self) -> tuple[str, ...]:
        """Agents that need a port."""
        return tuple(dict.fromkeys(listener for listener, _ in self.pairs))

    def endpoints(
        self,
        agent: str,
        tcp_ports: Mapping[str, int],
        host_of: Callable[[str], str] = lambda agent: "tcp/127.0.0.1",
    ) -> tuple[list[str], list[str]]:
        """Endpoints that an agent listens on, and those it connects to.

        `host_of` gives the protocol and the address of an agent.
        """
        tops = [top for top, below in self.pairs if below == agent]
        listens = [f"{host_of(agent)}:{tcp_ports[agent]}"] if agent in self.listening else []
        return listens, [f"{host_of(top)}:{tcp_ports[top]}" for top in tops]

    def peers(self, agent: str) -> tuple[str, ...]:
        linked = [pair for pair in self.pairs if agent in pair]
        return tuple(below if top == agent else top for top, below in linked)


def explicit_links(tree: ControlTree, standbys: Collection[str] = ()) -> Links:
    """Return one link for each pair of agents of which one publishes what the other listens to.

    A standby has the links of its agent, and one to its agent's process.
    """
    agents = tree.agents()
    rank = {agent: place for place, agent in enumerate((*agents, *map(standby_of, standbys)))}
    pairs: set[tuple[str, str]] = {(RECORDER, agent) for agent in agents if agent != RECORDER}
    for port in ports(tree):
        source = port.publisher
        for sink in listeners(port, tree):
            top, below = sorted((source, sink), key=rank.__getitem__)
            pairs.add((top, below))
    for agent in standbys:
        beside = standby_of(agent)
        for pair in [pair for pair in pairs if agent in pair]:
            top, below = (beside if end == agent else end for end in pair)
            pairs.add((top, below))
        pairs.add((agent, beside))
    return Links(tuple(sorted(pairs, key=lambda pair: (rank[pair[0]], rank[pair[1]]))))
