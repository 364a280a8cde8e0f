"""Who is heard: by the recorder, and by its listeners, which state what is `missing`."""

from __future__ import annotations

from collections import defaultdict
from typing import Final, TypeAlias

from agents.cycle import stage_of
from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.messages import Head, Message, parse_missing
from bus_schemas.signals import Port
from bus_schemas.tree import PLANT, agent_name
from recordings.read.gaps import lacks
from recordings.record.phases import longest_pause_s

_LATE_CYCLES: Final = 2
"""A listener does not hear a process whose newest message is older than this."""

_StageKey: TypeAlias = tuple[str, str]


class Reach:
    """When the recorder last heard each agent, and which processes no listener hears.

    A stage of a listener lacks a process if all messages that it awaits from it are missing. That
    proves nothing where the recorder does not hear them either: a process that lacks its own inputs
    may have nothing to say. A listener that lacks all others is itself cut off. Devices give no
    evidence.
    """

    def __init__(self, plan: RunPlan, now_ns: int) -> None:
        self._plan = plan
        self._heard_at_ns = dict.fromkeys((PLANT, *map(agent_name, plan.tree.nodes)), now_ns)
        self._looked_at_ns = now_ns
        self._pause_ns = round(longest_pause_s(plan) * 1e9)
        self._awaited = _awaited(plan)
        # The newest cycle of a message of each port that another process awaits.
        self._said_in = {
            key: 0 for of in self._awaited.values() for keys in of.values() for key in keys
        }
        self._silent_cycles = _LATE_CYCLES * plan.control.periods.longest
        self._newest = dict.fromkeys(self._heard_at_ns, 0)
        # The processes that each stage of a listener lacks, by its newest message.
        self._lacks: dict[_StageKey, frozenset[str]] = {}

    def hear(self, port: Port[Message], head: Head, payload: bytes, now_ns: int) -> None:
        source = head.source
        if source not in self._newest:  # An operator speaks when it likes.
            return
        self._heard_at_ns[source] = now_ns
        if head.cycle < self._newest[source]:  # It comes after later ones.
            return
        self._newest[source] = head.cycle
        if (key := str(port)) in self._said_in:
            self._said_in[key] = head.cycle
        missing = lacks(payload)
        if not missing and not self._lacks:
            return
        stage = source, stage_of(port, self._plan.tree)
        if not missing:
            self._lacks.pop(stage, None)
        elif stage in self._awaited:
            self._lacks[stage] = self._lacked(stage, head.cycle, missing)

    def _lacked(self, stage: _StageKey, cycle: int, missing: tuple[str, ...]) -> frozenset[str]:
        late = set()
        for key, used in map(parse_missing, missing):
            port = self._plan.wiring.port(f"{self._plan.plant}/{key}")
            if port is not None and (
                used is None or cycle - used > _LATE_CYCLES * self._plan.control.period(port)
            ):
                late.add(key)
        return frozenset(name for name, keys in self._awaited[stage].items() if keys <= late)

    def not_recorded(self, now_ns: int) -> list[str]:
        """Return the agents that the recorder has not heard for a while.

        Between two calls with a long time between them the recorder itself stood still.
        """
        if now_ns > self._looked_at_ns + self._pause_ns:
            self._heard_at_ns = dict.fromkeys(self._heard_at_ns, now_ns)
        self._looked_at_ns = now_ns
        return [name for name, at in self._heard_at_ns.items() if at < now_ns - self._pause_ns]

    def not_heard(self, now_ns: int) -> list[str]:
        """Return the processes that none of their listeners hears.

        A listener that the recorder does not hear itself gives no evidence.
        """
        if not self._lacks:
            return []
        no_evidence = {*self.not_recorded(now_ns), *self._cut_off()}
        heard, lacked = set[str](), set[str]()
        for stage, awaited in self._awaited.items():
            if stage[0] not in no_evidence:
                not_here = self._lacks.get(stage, frozenset())
                lacked |= {process for process in not_here if self._says(process, awaited[process])}
                heard |= awaited.keys() - not_here
        return sorted(lacked - heard)

    def _says(self, process: str, keys: set[str]) -> bool:
        """Whether a process publishes on one of these keys while it publishes at all."""
        newest = max(self._newest[name] for name in self._plan.wiring.members[process])
        return max(self._said_in[key] for key in keys) >= newest - self._silent_cycles

    def _cut_off(self) -> list[str]:
        """Return the listeners that await several processes and hear none."""
        hears, lacking = defaultdict[str, set[str]](set), defaultdict[str, set[str]](set)
        for stage, awaited in self._awaited.items():
            lacked = self._lacks.get(stage, frozenset())
            lacking[stage[0]] |= lacked
            hears[stage[0]] |= awaited.keys() - lacked
        return [name for name, of in lacking.items() if len(of) > 1 and not hears[name]]


def _awaited(plan: RunPlan) -> dict[_StageKey, dict[str, set[str]]]:
    """Return the keys that each stage of a listener awaits of each other process."""
    process_of = plan.wiring.process_of
    found: dict[_StageKey, dict[str, set[str]]] = {}
    for agent, cycles in stages_of_agents(plan).items():
        if agent in plan.access.external:
            continue
        for stage in (stage for stages in cycles for stage in stages):
            for port in stage.awaits:
                if (process := process_of(port.publisher)) != process_of(agent):
                    keys = found.setdefault((agent, stage.name), {})
                    keys.setdefault(process, set()).add(str(port))
    return found
