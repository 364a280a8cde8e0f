"""The state of every node of a plant in one cycle of its recording, as the page shows it."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from typing import Any, Final, NamedTuple, TypeAlias

import msgspec

from agents.cycle import kind_of, stage_of, stage_place
from agents.dispatch import own_request_kw
from bus_schemas.codec import decode
from bus_schemas.messages import Dispatch, Impp, Message, Production, Setpoint
from bus_schemas.missing import parse_missing
from bus_schemas.signals import DISPATCH, IMPP, PRODUCTION, RUN, SETPOINT, TELEMETRY, Port
from bus_schemas.tree import PLANT, ROOT, agent_name, depth
from live_page.follower import MOST_CHUNKS, RunFollower
from recordings.read.chunks import ChunkPlace
from recordings.read.reader import head_of

Column: TypeAlias = list[float | None]
Messages: TypeAlias = dict[Port[Message], Message]

_FURTHEST_BACK: Final = 100
"""Cycles in which an agent is looked for that is silent in the one shown."""

_UNHELPFUL_KW: Final = 0.005


class _Stage(NamedTuple):
    """Where in a cycle a message belongs."""

    place: int
    label: str
    deadline_ms: float | None


class NodeStates:
    """Reads the state of a plant's nodes from its recording, cycle by cycle.

    `agents` are the plant, then the controllers in the order of the tree's nodes.
    """

    def __init__(self, follower: RunFollower) -> None:
        self.follower = follower
        self._plan = plan = follower.plan
        self._tree = tree = plan.tree
        self._place = {node: place for place, node in enumerate(tree.nodes)}
        self._below = [tree.leaves_below(node) for node in tree.nodes]
        self.agents = (PLANT, *(agent_name(node) for node in tree.nodes))
        self._parsed = lru_cache(MOST_CHUNKS + 4)(self._parse)
        self._stages = self._stages_of(port for port in plan.wiring.ports if port.signal.is_cyclic)
        self.frame = lru_cache(32)(self._frame)

    def series(self, node: str, cycle: int) -> dict[str, float | None]:
        """Return the powers of one node in a cycle [kW]."""
        wanted = {DISPATCH.of(ROOT), PRODUCTION.of(ROOT), IMPP.of(node)}
        if node != ROOT:
            wanted.add(SETPOINT.of(node))
        return self._powers(self.messages(cycle, wanted), node)

    def messages(self, cycle: int, ports: Collection[Port[Message]]) -> Messages:
        """Return what was said on some ports in a cycle; of setpoints the newest."""
        return self._messages_at(cycle, ports)[0]

    def _frame(self, cycle: int) -> dict[str, Any]:
        """Return the state of all nodes in a cycle, a list for each quantity."""
        found, newest = self._messages_at(cycle, None)
        devices = [node for node, _ in self._plan.devices]
        return {
            "cycle": cycle,
            "nodes": columns([self._powers(found, node) for node in self._tree.nodes]),
            "help": self._help(found),
            "agents": self._agents(cycle, found, newest),
            "unread": [self._place[node] for node in devices if TELEMETRY.of(node) not in found],
            "timing": self._timing(cycle, found),
        }

    def _powers(self, found: Messages, node: str) -> dict[str, float | None]:
        """Return the powers of a node [kW]; None: no message states it.

        `help` is the setpoint less the node's share of its parent's target: negative if the node
        gets help. The central controller's setpoint is the dispatch.
        """
        dispatch, made = found.get(DISPATCH.of(ROOT)), found.get(PRODUCTION.of(ROOT))
        assert dispatch is None or isinstance(dispatch, Dispatch)
        impp = found.get(IMPP.of(node))
        setpoint = found.get(SETPOINT.of(node)) if node != ROOT else dispatch
        helped = setpoint.power_kw - setpoint.share_kw if isinstance(setpoint, Setpoint) else None
        below = self._below[self._place[node]]
        powers = {
            "impp": impp.power_kw if isinstance(impp, Impp) else None,
            "request": own_request_kw(dispatch, self._tree.rating_kw(node)),
            "setpoint": setpoint.power_kw if isinstance(setpoint, Setpoint | Dispatch) else None,
            "help": helped,
            "power": _total(made, "inverter_power_kw", below),
            "mpp": _total(made, "inverter_mpp_kw", below),
        }
        return {name: None if kw is None else round(kw, 2) for name, kw in powers.items()}

    def _help(self, found: Messages) -> list[tuple[int, int, float]]:
        """Return who helps whom by how much: places of donor and needy, kW."""
        return [
            (self._place[port.node], self._place[given.needy], round(given.power_kw, 2))
            for port, message in found.items()
            if isinstance(message, Setpoint)
            for given in message.help_given
            if given.needy in self._place and given.power_kw > _UNHELPFUL_KW
        ]

    def _agents(self, cycle: int, found: Messages, newest: dict[str, int]) -> dict[str, Column]:
        """Return how the agents do: the plant first, then the nodes.

        `age`: cycles since the newest message of an agent, None where none was found. `missed`:
        inputs that were missing or older than they should have been; `input_age`: how old the
        oldest of them was. `loop_ms`: from the last input of a stage to its message.
        """
        said: dict[str, list[Message]] = {agent: [] for agent in self.agents}
        for message in found.values():
            if message.cycle == cycle and message.source in said:
                said[message.source].append(message)
        rows: list[dict[str, float | None]] = []
        for agent, messages in said.items():
            missed = [parse_missing(entry) for one in messages for entry in one.missing]
            older = [cycle - one.cycle for one in missed if one.cycle is not None]
            ready = [one for one in messages if one.ready_time_ns]
            loops_ns = [one.publish_time_ns - one.ready_time_ns for one in ready]
            rows.append(
                {
                    "age": cycle - newest[agent] if agent in newest else None,
                    "missed": len(missed),
                    "input_age": max(older, default=0),
                    "loop_ms": round(max(loops_ns) / 1e6, 3) if loops_ns else None,
                    "restarts": self.follower.restarts[agent],
                }
            )
        return columns(rows)

    def _timing(self, cycle: int, found: Messages) -> list[dict[str, object]]:
        """Return when the messages of each stage went out, after the beginning of the cycle [ms].

        In lockstep a cycle begins with its first message.
        """
        times_ns: dict[_Stage, list[int]] = {}
        for port, message in found.items():
            is_here = port.publisher not in self._plan.external  # A device has its own clock.
            if port in self._stages and message.cycle == cycle and is_here:
                times_ns.setdefault(self._stages[port], []).append(message.publish_time_ns)
        begin_ns = min(chain.from_iterable(times_ns.values()), default=0)
        if not self._plan.lockstep and self.follower.start_time_ns is not None:
            begin_ns = self.follower.start_time_ns + cycle * self._plan.cycle_wall_ns
        return [
            {
                "stage": stage.label,
                "deadline_ms": stage.deadline_ms,
                "first_ms": round((min(times_ns[stage]) - begin_ns) / 1e6, 3),
                "last_ms": round((max(times_ns[stage]) - begin_ns) / 1e6, 3),
            }
            for stage in sorted(times_ns, key=lambda stage: stage.place)
        ]

    def _stages_of(self, ports: Iterable[Port[Message]]) -> dict[Port[Message], _Stage]:
        """Return the stage of each port. Its deadline is when those close that wait for it."""
        plan, tree = self._plan, self._tree
        stages: dict[Port[Message], tuple[int, str]] = {}
        closes_ns: dict[int, int] = {}
        for port in ports:
            agent, stage = port.publisher, stage_of(port, tree)
            kind = kind_of(agent, tree)
            label = f"{stage}, {kind}"
            if kind == "supervisor":
                label += f" tier {depth(agent)}"
            place = stage_place(agent, stage, tree)
            stages[port] = place, label
            closes_ns[place] = plan.deadlines.deadline_ns(agent, stage)
        closes_ns[max(closes_ns) + 1] = plan.cycle_wall_ns
        return {
            port: _Stage(place, label, None if plan.lockstep else closes_ns[place + 1] / 1e6)
            for port, (place, label) in stages.items()
        }

    def _messages_at(
        self, cycle: int, ports: Collection[Port[Message]] | None
    ) -> tuple[Messages, dict[str, int]]:
        """Return the messages of a cycle by port, and the newest cycle of each agent by then.

        Of setpoints, which do not come in every cycle, the newest one.
        """
        longest = self._plan.periods.longest
        parsed = [self._parsed(place) for place in self.follower.chunks_with(cycle, longest)]
        payloads: dict[Port[Message], bytes] = {}
        newest: dict[str, int] = {}
        for back in range(max(longest, _FURTHEST_BACK if ports is None else 1)):
            for port, payload in chain.from_iterable(one.get(cycle - back, ()) for one in parsed):
                newest.setdefault(port.publisher, cycle - back)
                wanted = back == 0 or (port.signal is SETPOINT and back < longest)
                if wanted and (ports is None or port in ports):
                    payloads.setdefault(port, payload)
            if back >= longest - 1 and len(newest) == len(self.agents):
                break
        found: Messages = {}
        for port, payload in payloads.items():
            with suppress(msgspec.DecodeError):  # A device of the user's may send anything.
                found[port] = decode(port.signal, payload)
        return found, newest

    def _parse(self, place: ChunkPlace) -> dict[int, list[tuple[Port[Message], bytes]]]:
        """Return the messages in a chunk by their cycle."""
        found: dict[int, list[tuple[Port[Message], bytes]]] = {}
        run = self.follower.run
        for channel, _, _, _, payload in run.messages_of(place, run.channels):
            port = run.channels[channel]
            if port.signal is not RUN:
                found.setdefault(head_of(payload).cycle, []).append((port, payload))
        return found


def columns(rows: list[dict[str, float | None]]) -> dict[str, Column]:
    """Return the values of each name as a list; `rows` has at least one."""
    return {name: [row[name] for row in rows] for name in rows[0]}


def _total(made: Message | None, field: str, below: tuple[int, ...]) -> float | None:
    """Add up what a production says of some inverters; None where it does not tell."""
    if not isinstance(made, Production):
        return None
    values: tuple[float, ...] = getattr(made, field)
    return sum(values[place] for place in below) if below[-1] < len(values) else None
