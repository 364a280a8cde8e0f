"""The state of a plant in each cycle, as the page shows it: worked out from messages alone."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from math import ceil
from typing import Any, Final, TypeAlias

from agents.control.forecast import BOUND_TOLERANCE
from agents.dispatch import own_share_kw
from bus_schemas.codec import UNREADABLE
from bus_schemas.messages import (
    Dispatch,
    Impp,
    Message,
    Production,
    Setpoint,
    Telemetry,
    parse_missing,
)
from bus_schemas.signals import DISPATCH, IMPP, PRODUCTION, RUN, SETPOINT, TELEMETRY, Port
from bus_schemas.tree import ROOT, ancestors
from live_page.follower import RunFollower
from recordings.read.mcap_file import Chunk
from sim_plant.orders import is_ordered, order_text, target_kw

_UNHELPFUL_KW: Final = 0.005

Messages: TypeAlias = dict[Port[Message], Message]

_CACHED_CHUNKS: Final = 40


class PlantState:
    """Works out the state of the plant in a recording. Nodes are numbered in the order of the tree.

    `frame` returns the state of all nodes in a cycle.
    """

    def __init__(self, follower: RunFollower) -> None:
        plan = follower.plan
        self.frame = lru_cache(32)(self._frame)
        self._follower = follower
        self._by_cycle = lru_cache(_CACHED_CHUNKS)(self._read_chunk)
        self._plan = plan
        self._tree = plan.tree
        self._number = {node: number for number, node in enumerate(plan.tree.nodes)}
        self._telemetry = [TELEMETRY.of(leaf) for leaf in plan.tree.leaves]
        self._ratings_kw = [plan.tree.rating_kw(leaf) for leaf in plan.tree.leaves]
        self._leaves_below = {node: plan.tree.leaves_below(node) for node in plan.tree.nodes}
        self._storages_below = defaultdict[str, list[int]](list)
        for place, storage in enumerate(plan.tree.storage_paths):
            for node in (storage, *ancestors(storage)):
                self._storages_below[node].append(place)
        self._ports_of: dict[str, tuple[Port[Any], Port[Any]]] = {
            node: (IMPP.of(node), SETPOINT.of(node) if node else DISPATCH.of(node))
            for node in plan.tree.nodes
        }

    def _messages(self, cycle: int, ports: Collection[Port[Message]] | None = None) -> Messages:
        """Return the messages of a cycle, on some ports alone if they are given.

        A setpoint that is not due in it is that of its parent's last turn.
        """
        control, messages = self._plan.control, Messages()
        turns = {cycle // length * length for length in (1, *control.period_cycles)}
        for turn in turns:
            chunks = map(self._by_cycle, self._follower.chunks_with(turn))
            for port, payload in chain.from_iterable(one.get(turn, ()) for one in chunks):
                period = control.period(port)
                is_due = cycle // period * period == turn or turn == cycle
                if is_due and port not in messages and (ports is None or port in ports):
                    with suppress(*UNREADABLE):  # A device of the user's may send anything.
                        messages[port] = port.signal.decode(payload)
        return messages

    def _read_chunk(self, chunk: Chunk) -> dict[int, list[tuple[Port[Message], bytes]]]:
        by_cycle: dict[int, list[tuple[Port[Message], bytes]]] = {}
        for record in self._follower.run.records_of(chunk):
            if record.port.signal is not RUN:
                by_cycle.setdefault(record.cycle, []).append((record.port, record.payload))
        return by_cycle

    def _frame(self, cycle: int) -> dict[str, Any]:
        """Return a list for each quantity."""
        messages = self._messages(cycle)
        devices = [node for node, _ in self._plan.site.devices]
        unread = [self._number[node] for node in devices if TELEMETRY.of(node) not in messages]
        return {
            "cycle": cycle,
            "nodes": columns(list(self._powers(messages, self._tree.nodes))),
            "help": self._help(messages),
            "agents": columns(list(self._agent_rows(cycle, messages))),
            "unread": unread,
            "order": self._order(messages),
        }

    def _order(self, messages: Messages) -> dict[str, Any] | None:
        """Return what the plant is asked for, by whom, and the cycles of its order."""
        dispatch = messages.get(DISPATCH.of(ROOT))
        if not isinstance(dispatch, Dispatch):
            return None
        given, holds_s = is_ordered(dispatch), dispatch.order_hold_s
        length = None if holds_s is None else ceil(holds_s / self._plan.timing.cycle_s)
        return {
            "source": dispatch.order_source,
            "text": order_text(dispatch) if dispatch.order_source else "the schedule",
            "since": dispatch.order_cycle if given else None,
            "until": dispatch.order_renewed + length if given and length is not None else None,
            "power_kw": round(dispatch.power_kw, 2),
            "target_kw": round(target_kw(dispatch), 2),
        }

    def powers(self, node: str, cycle: int) -> dict[str, float | None]:
        """Return the powers of one node in a cycle [kW]."""
        ports: set[Port[Any]] = {DISPATCH.of(ROOT), PRODUCTION.of(ROOT), *self._ports_of[node]}
        ports |= {self._telemetry[leaf] for leaf in self._leaves_below[node]}
        return next(self._powers(self._messages(cycle, ports), [node]))

    def _powers(
        self, messages: Messages, nodes: Sequence[str]
    ) -> Iterator[dict[str, float | None]]:
        """Yield the powers of nodes [kW]; None: no message states it. All are below the first.

        `help` is the setpoint less the node's share of its parent's target: negative if the node
        gets help. The central controller's setpoint is the dispatch. `bound` is the IMPP where that
        is only an upper bound: a limit hides the maximum of an inverter below the node. `stored` is
        what is in a storage, in % of its capacity.
        """
        dispatch, made = messages.get(DISPATCH.of(ROOT)), messages.get(PRODUCTION.of(ROOT))
        assert dispatch is None or isinstance(dispatch, Dispatch)
        hidden = {leaf for leaf in self._leaves_below[nodes[0]] if self._is_hidden(messages, leaf)}
        for node in nodes:
            impp, given = map(messages.get, self._ports_of[node])
            impp_kw = impp.power_kw if isinstance(impp, Impp) else None
            below = self._leaves_below[node]
            powers = {
                "bound": None if hidden.isdisjoint(below) else impp_kw,
                "impp": impp_kw,
                "share": own_share_kw(dispatch, self._tree.sharing_kw(node)),
                "setpoint": given.power_kw if isinstance(given, Setpoint | Dispatch) else None,
                "help": given.power_kw - given.share_kw if isinstance(given, Setpoint) else None,
                "power": _total(made, "inverter_power_kw", below),
                "mpp": _total(made, "inverter_mpp_kw", below) if below else None,
                "stored": None,
            }
            if node in self._storages_below:
                self._add_storages(powers, made, node)
            yield {name: None if kw is None else round(kw, 2) for name, kw in powers.items()}

    def _add_storages(
        self, powers: dict[str, float | None], made: Message | None, node: str
    ) -> None:
        """Add the power of the storages at or below a node; of a storage, what it holds [%]."""
        storages = self._storages_below[node]
        power_kw, of_storages_kw = powers["power"], _total(made, "storage_power_kw", storages)
        is_unknown = power_kw is None or of_storages_kw is None
        powers["power"] = None if is_unknown else (power_kw or 0.0) + (of_storages_kw or 0.0)
        if not self._leaves_below[node]:
            kwh = _total(made, "storage_energy_kwh", storages)
            capacity_kwh = self._plan.storages[storages[0]].capacity_kwh
            powers["stored"] = None if kwh is None else 100.0 * kwh / capacity_kwh

    def _is_hidden(self, messages: Messages, leaf: int) -> bool:
        """Whether an inverter gives what its limit lets it, and does not state what it could."""
        read = messages.get(self._telemetry[leaf])
        if not isinstance(read, Telemetry) or read.available_kw is not None:
            return False
        is_limited = read.limit_kw < self._ratings_kw[leaf]
        return is_limited and read.power_kw >= read.limit_kw * (1.0 - BOUND_TOLERANCE)

    def _help(self, messages: Messages) -> list[tuple[int, int, float]]:
        """Return who helps whom by how much: numbers of donor and needy, kW."""
        return [
            (self._number[port.node], self._number[given.needy], round(given.power_kw, 2))
            for port, message in messages.items()
            if isinstance(message, Setpoint)
            for given in message.help_given
            if given.needy in self._number and given.power_kw > _UNHELPFUL_KW
        ]

    def _agent_rows(self, cycle: int, messages: Messages) -> Iterator[dict[str, Any]]:
        """Yield how the agents do: the plant first, then the nodes, see `AgentState`.

        `input_age`: how old the oldest input was that an agent used. `loop_ms`: from the last input
        of a stage to its message.
        """
        states = self._follower.states
        by_agent: dict[str, list[Message]] = {agent: [] for agent in states.agents}
        for message in messages.values():
            if message.cycle == cycle and message.source in by_agent:
                by_agent[message.source].append(message)
        for agent, own in by_agent.items():
            missed = {parse_missing(entry) for one in own for entry in one.missing}
            older = [cycle - one.cycle for one in missed if one.cycle is not None]
            loops_ns = [one.publish_time_ns - one.ready_time_ns for one in own if one.ready_time_ns]
            yield {
                **states.at(agent, cycle).document(),
                "input_age": max(older, default=0),
                "loop_ms": round(max(loops_ns) / 1e6, 3) if loops_ns else None,
            }


def columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Return the values of each name as a list; `rows` has at least one."""
    return {name: [row[name] for row in rows] for name in rows[0]}


def _total(made: Message | None, field: str, below: Sequence[int]) -> float | None:
    """Add up what a production says of some devices; None where it does not tell."""
    if not isinstance(made, Production):
        return None
    values: tuple[float, ...] = getattr(made, field) or ()
    is_told = not below or below[-1] < len(values)
    return sum(map(values.__getitem__, below)) if is_told else None
