"""The messages of a run, and what each process decided on which of them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from agents.agent import Stage
from agents.control.share import share_kw, usable_dispatch_kw
from agents.cycle import stage_of
from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.messages import Message, parse_missing
from bus_schemas.signals import DISPATCH, PRODUCTION, TELEMETRY, Port
from bus_schemas.tree import CENTRAL, ROOT

Found: TypeAlias = list[tuple[int, str]]
Breaches: TypeAlias = Iterator[tuple[int, str]]
"""Cycles in which something is wrong, and what."""

EXACT: Final = 1e-6
"""Rounding error, as a share of a rating."""


@dataclass
class Trace:
    """The messages of a run by port and cycle, one of each process. Call it with each message.

    `twice` are messages that one process sent again in a cycle. `ended` says why the run ended
    before its time; it is empty if it did not.
    """

    of: dict[Port[Message], dict[int, list[Any]]] = field(default_factory=dict)
    twice: Found = field(default_factory=list)
    ended: str = ""

    def __call__(self, port: Port[Message], message: Message) -> None:
        if message.cycle < 0 or not port.signal.decided:
            return
        sent = self.of.setdefault(port, {}).setdefault(message.cycle, [])
        if any(other.incarnation == message.incarnation for other in sent):
            self.twice.append((message.cycle, f"{port} comes twice in one cycle"))
        sent.append(message)

    @property
    def produced(self) -> list[Any]:
        return [one for (one,) in self.of.get(PRODUCTION.of(ROOT), {}).values()]

    @property
    def delivered_kw(self) -> NDArray[np.float64]:
        return np.array([one.delivered_kw for one in self.produced])


@dataclass(frozen=True)
class Decision:
    """What a process sent in a stage of a cycle, and the messages that it says it used.

    used: None where there was no message.
    is_doubtful: Whether two processes sent one of those.
    reported: What it sent in its first stage of this cycle.
    was_measured: Of a direct controller: whether the process had heard its inverter.
    """

    plan: RunPlan
    agent: str
    stage: str
    cycle: int
    outputs: Mapping[Port[Message], Any]
    used: Mapping[Port[Message], Any]
    is_doubtful: bool
    reported: Mapping[Port[Message], Any]
    was_measured: bool

    @property
    def node(self) -> str:
        return ROOT if self.agent == CENTRAL else self.agent

    def share_kw(self, node: str) -> float | None:
        """Return a node's share of the dispatch that was used [kW]."""
        dispatch, tree = self.used[DISPATCH.of(ROOT)], self.plan.tree
        if dispatch is None:
            return None
        plant_kw = tree.rating_kw(ROOT)
        usable_kw = usable_dispatch_kw(dispatch.power_kw, plant_kw)
        return share_kw(usable_kw, tree.rating_kw(node), plant_kw)


@dataclass
class FaultyRun:
    """A run under faults, as the invariants see it.

    healthy_kw: Power of the same run without faults, shape (cycles,) [kW].
    quiet: First cycle with a fault, and that from which on all must be as if there had been none.
    longest: How many cycles power may be out of bounds at a time: what the faults allow.
    stopped: Cycles in which processes were killed or stood still, by agent.
    zombies: Agents of which a process woke up beside its successor, hearing nobody.
    """

    plan: RunPlan
    trace: Trace
    healthy_kw: NDArray[np.float64]
    quiet: tuple[float, float]
    longest: int
    stopped: Mapping[str, Sequence[range]]
    zombies: Collection[str]
    wrong_inputs: Found = field(default_factory=list)

    def is_quiet(self, cycle: int) -> bool:
        return not self.quiet[0] <= cycle < self.quiet[1]

    @cached_property
    def decisions(self) -> list[Decision]:
        """All decisions in the order of agents and cycles, but those of replaced processes."""
        turns_of = stages_of_agents(self.plan)
        return [one for agent, turns in turns_of.items() for one in self._of_agent(agent, turns)]

    def _of_agent(self, agent: str, turns: Sequence[Sequence[Stage]]) -> Iterator[Decision]:
        plan, of = self.plan, self.trace.of
        ports_of: dict[str, list[Port[Message]]] = {}
        for port in plan.wiring.published[agent]:
            if port.signal.decided:
                ports_of.setdefault(stage_of(port, plan.tree), []).append(port)
        speaks, was_measured, heard = 0, False, dict[Port[Message], tuple[int, int]]()
        for cycle in range(len(self.trace.produced)):
            reported: dict[Port[Message], Any] = {}
            for stage in turns[cycle % len(turns)]:
                ports = ports_of[stage.name]
                sent = [(port, one) for port in ports for one in of.get(port, {}).get(cycle, ())]
                newest = max((one.incarnation for _, one in sent), default=-1)
                if newest < speaks:
                    continue
                if newest > speaks:
                    speaks, was_measured, heard = newest, False, {}
                outputs = {port: one for port, one in sent if one.incarnation == newest}
                used, is_doubtful = self._used(agent, stage, next(iter(outputs.values())), heard)
                was_measured |= used.get(TELEMETRY.of(agent)) is not None
                words = (outputs, used, is_doubtful, reported, was_measured)
                yield Decision(plan, agent, stage.name, cycle, *words)
                reported = reported or outputs

    def _used(
        self,
        agent: str,
        stage: Stage,
        message: Message,
        heard: dict[Port[Message], tuple[int, int]],
    ) -> tuple[dict[Port[Message], Any], bool]:
        """Return the inputs of a decision by port, and whether two processes sent one of them.

        heard: Newest cycle of each input, and the newest process that the agent must have heard.
        """
        control, cycle, is_doubtful = self.plan.control, message.cycle, False
        missing = dict(map(parse_missing, message.missing))
        wrong = [f"{', '.join(message.missing)}"] if missing and self.is_quiet(cycle) else []
        used: dict[Port[Message], Any] = {}
        for port in (*stage.awaits, *stage.uses):
            used[port], period = None, control.period(port)
            of = missing.get(str(port), cycle - cycle % period)
            if of is None:
                if port in heard and cycle - heard[port][0] - period < control.hold_cycles:
                    wrong.append(f"{port}, heard in cycle {heard[port][0]}")
                continue
            newest, process = heard.get(port, (of, 0))
            sent = self.trace.of.get(port, {}).get(of, ())
            known = [one for one in sent if one.incarnation >= process]
            if not known or of < newest or cycle - of - period + 1 > control.hold_cycles:
                wrong.append(f"{port} of cycle {of}")
            if known:
                used[port] = max(known, key=lambda one: one.incarnation)
                heard[port] = of, process if len(sent) > 1 else known[0].incarnation
            is_doubtful |= len(known) != 1
        self.wrong_inputs += ((cycle, f"{agent} should not use, or miss: {it}") for it in wrong)
        return used, is_doubtful
