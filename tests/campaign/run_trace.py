"""The messages of a run, and what each process decided on which of them.

It knows the wire document alone: which messages a stage sends, and on which it rests.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.plan import RunPlan
from bus_schemas.messages import Message, parse_missing
from bus_schemas.signals import Port
from bus_schemas.tree import CENTRAL, PLANT, ROOT, agent_name
from sim_plant.profile import Profile

EXACT: Final = 1e-6
"""Rounding error, as a share of a rating."""


class Trace:
    """The messages of a run by key and cycle, one of each process. Call it with each message.

    twice: Messages that one process sent again in a cycle.
    ended: Why the run ended before its time; empty if it did not.
    """

    def __init__(self) -> None:
        self.of: dict[str, dict[int, list[Any]]] = {}
        self.twice: list[tuple[int, str]] = []
        self.ended = ""

    def __call__(self, port: Port[Message], message: Message) -> None:
        if message.cycle < 0 or not port.signal.decided:
            return
        sent = self.of.setdefault(str(port), {}).setdefault(message.cycle, [])
        if any(other.incarnation == message.incarnation for other in sent):
            self.twice.append((message.cycle, f"{port} comes twice in one cycle"))
        sent.append(message)

    @cached_property
    def produced(self) -> list[Any]:
        return [one for _, (one, *_) in sorted(self.of.get("production", {}).items())]

    @cached_property
    def cycles(self) -> NDArray[np.int64]:
        """The cycles that the plant went through: it skips some if it stands still."""
        return np.array([one.cycle for one in self.produced])

    @cached_property
    def delivered_kw(self) -> NDArray[np.float64]:
        return np.array([one.delivered_kw for one in self.produced])


class Stage(NamedTuple):
    """What an agent sends in a stage (always, or if there is a need), and what it uses for it."""

    name: str
    sends: tuple[str, ...]
    uses: tuple[str, ...]


def key(node: str, signal: str) -> str:
    return f"{node}/{signal}" if node else signal


@dataclass(frozen=True)
class Decision:
    """What a process sent in a stage of a cycle, and the messages that it says it used.

    used: None where there was no message.
    doubtful: Inputs that two processes sent.
    reported: What it sent in its first stage of this cycle.
    process: Its incarnation.
    """

    agent: str
    node: str
    stage: str
    cycle: int
    process: int
    sent: Mapping[str, Any]
    used: Mapping[str, Any]
    doubtful: Collection[str]
    reported: Mapping[str, Any]


@dataclass
class FaultyRun:
    """A run under faults, as its judges see it.

    healthy: The same run without faults; None: this is it.
    quiet: First cycle with a fault, and that from which on all must be as if there had been none.
    longest: How many cycles power may be out of bounds at a time: what the faults allow.
    stopped: Cycles in which processes were killed or stood still, by agent.
    away: Cycles in which a process cannot speak, by agent: in the same runs.
    returns: Cycles from which on a process must speak again, by agent: where no link has a fault.
    zombies: Agents of which a process woke up beside its successor, hearing nobody.
    """

    plan: RunPlan
    profile: Profile
    trace: Trace
    healthy: FaultyRun | None
    quiet: tuple[float, float]
    longest: int
    stopped: Mapping[str, Sequence[range]]
    returns: Mapping[str, Sequence[int]] = field(default_factory=dict)
    away: Mapping[str, Sequence[range]] = field(default_factory=dict)
    zombies: Collection[str] = ()
    wrong_inputs: list[tuple[int, str]] = field(default_factory=list)

    def is_quiet(self, cycle: int) -> bool:
        return not self.quiet[0] <= cycle < self.quiet[1]

    def is_stopped(self, agent: str, cycle: int) -> bool:
        return any(cycle in cycles for cycles in self.stopped.get(agent, ()))

    def rating_kw(self, node: str = ROOT) -> float:
        return self.plan.tree.rating_kw(node)

    def inverters_kw(self, node: str = ROOT) -> float:
        """Return the sum of the ratings of the inverters at or below a node."""
        inverters = self.plan.inverters
        return sum(kw for path, kw in inverters if not node or f"{path}/".startswith(f"{node}/"))

    def sharing_kw(self, node: str) -> float:
        """Return the rating by which a node shares the dispatch: of a plant what it may feed in."""
        limits_kw = {one.name: one.export_limit_kw for one in self.plan.plants}
        plant = node.split("/", maxsplit=1)[0]
        part = limits_kw[plant] / self.inverters_kw(plant) if limits_kw else 1.0
        return self.inverters_kw(node) * part

    def columns(self, plant: str) -> list[int]:
        """Return the places of a plant's inverters."""
        leaves = self.plan.tree.leaves
        return [at for at, leaf in enumerate(leaves) if leaf.split("/")[0] == plant]

    def children(self, node: str) -> tuple[str, ...]:
        """Return those among which a parent shares out its target: no storages."""
        tree = self.plan.tree
        return tuple(child for child in tree.children(node) if not tree.is_storage(child))

    def acts(self, node: str, cycle: int) -> bool:
        """Whether it is a parent's turn to send setpoints."""
        tier = node.count("/") + 1 if node else 0
        return cycle % self.plan.control.period_cycles[tier] == 0

    def stages(self, node: str, cycle: int) -> tuple[Stage, ...]:
        children = self.plan.tree.children(node)
        reports, own = (key(node, "impp"), key(node, "residual")), key(node, "setpoint")
        if not children:
            estimate = Stage("estimate", reports, (key(node, "telemetry"), "dispatch"))
            return estimate, Stage("actuate", (key(node, "command"),), (own, "dispatch"))
        given = tuple(key(child, "setpoint") for child in children)
        heard = tuple(key(child, name) for child in children for name in ("impp", "residual"))
        if node == ROOT:
            return (Stage("solve", given, (*heard, "dispatch", "meter")),)
        report = Stage("report", reports, (*heard, "dispatch"))
        if node in {one.name for one in self.plan.plants}:
            heard = (*heard, key(node, "meter"))
            report = Stage("report", (*reports, key(node, "memory")), (*heard, "dispatch"))
        solve = Stage("solve", given, (own, *heard, "dispatch"))
        return (report, solve) if self.acts(node, cycle) else (report,)

    @cached_property
    def decisions(self) -> list[Decision]:
        """All decisions of controllers and plant by agent and cycle, but those of zombies."""
        return [
            *self._of_agent(PLANT, ROOT),
            *(
                one
                for node in self.plan.tree.nodes
                for one in self._of_agent(agent_name(node), node)
            ),
        ]

    def of_stage(self, *stages: str) -> Iterator[Decision]:
        """Yield the decisions of parents and inverters in some stages."""
        storages = self.plan.tree.storage_paths
        return (one for one in self.decisions if one.stage in stages and one.node not in storages)

    @cached_property
    def applied(self) -> list[Decision]:
        """What the plant decided in each cycle that it went through."""
        return [one for one in self.decisions if one.stage == "apply"]

    def _of_agent(self, agent: str, node: str) -> Iterator[Decision]:
        commands = tuple(key(one, "command") for one in self.plan.tree.devices)
        apply = (Stage("apply", ("production",), (*commands, "memory")),)
        speaks, heard = 0, dict[str, tuple[int, int]]()
        for cycle in range(self.plan.timing.cycles):
            reported: dict[str, Any] = {}
            for stage in apply if agent == PLANT else self.stages(node, cycle):
                extra = [key(node, "help")] if stage.name in {"estimate", "report"} else []
                extra += ["offer"] if agent == CENTRAL else []
                sent = [
                    (port, one)
                    for port in (*stage.sends, *extra)
                    for one in self.trace.of.get(port, {}).get(cycle, ())
                ]
                newest = max((one.incarnation for _, one in sent), default=-1)
                if newest < speaks:
                    continue
                if newest > speaks:
                    speaks, heard = newest, {}
                outputs = {port: one for port, one in sent if one.incarnation == newest}
                used, doubtful = self._used(agent, stage, next(iter(outputs.values())), heard)
                yield Decision(
                    agent, node, stage.name, cycle, newest, outputs, used, doubtful, reported
                )
                reported = reported or outputs

    def _period(self, port: str) -> int:
        """Return how many cycles there are from one message of a key to the next."""
        *path, signal = port.split("/")
        return self.plan.control.period_cycles[len(path) - 1] if signal == "setpoint" else 1

    def _used(
        self, agent: str, stage: Stage, message: Message, heard: dict[str, tuple[int, int]]
    ) -> tuple[dict[str, Any], list[str]]:
        """Return the inputs of a decision by key, and those that two processes sent.

        heard: Newest cycle of each input, and the newest process that the agent must have heard.
        """
        hold, cycle, doubtful = self.plan.control.hold_cycles, message.cycle, list[str]()
        missing = dict(map(parse_missing, message.missing))
        wrong = [", ".join(message.missing)] if missing and self.is_quiet(cycle) else []
        used: dict[str, Any] = {}
        for port in stage.uses:
            used[port], period = None, self._period(port)
            of = missing.get(port, cycle - cycle % period)
            if of is None:
                if port in heard and cycle - heard[port][0] - period < hold:
                    wrong.append(f"{port}, heard in cycle {heard[port][0]}")
                continue
            newest, process = heard.get(port, (of, 0))
            sent = self.trace.of.get(port, {}).get(of, ())
            known = [one for one in sent if one.incarnation >= process]
            if not known or of < newest or cycle - of - period + 1 > hold:
                wrong.append(f"{port} of cycle {of}")
            if known:
                used[port] = max(known, key=lambda one: one.incarnation)
                heard[port] = of, process if len(sent) > 1 else known[0].incarnation
            if len(known) != 1:
                doubtful.append(port)
        self.wrong_inputs += ((cycle, f"{agent} should not use, or miss: {it}") for it in wrong)
        return used, doubtful
