"""How a run fared, by its recording: faults, lost messages, missed inputs, states of agents."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from typing import Final

import msgspec

from agents.faults import Fault, Kill, ProcessFault
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.inspect.agent_states import AgentSpan, AgentStates
from recordings.read.reader import RecordedMessage, RunReader

_MOST_STATES: Final = 100


class FaultEffect(msgspec.Struct, frozen=True):
    """How many messages a fault acted on, once for each listener, and in which cycles."""

    fault: Fault
    messages: int = 0
    first_cycle: int | None = None
    last_cycle: int | None = None


class Misses(msgspec.Struct, frozen=True):
    """Inputs that an agent missed at its deadlines, and older messages that it used."""

    agent: str
    inputs: int
    old: int
    first_cycle: int
    last_cycle: int
    external: bool


class Health(msgspec.Struct, frozen=True, kw_only=True):
    """How a run fared.

    `faults` counts what all rules did to messages, by kind. `lost` counts messages that the
    sequence numbers leave out, by port, most first. `misses` are by agent, most first. The run
    ended before the `stop_cycle`; None: that is not recorded. `states`: when agents were absent,
    cut off or given up.
    """

    fault_effects: tuple[FaultEffect, ...] = ()
    faults: dict[str, int] = {}
    lost: dict[str, int] = {}
    repeated: int = 0
    misses: tuple[Misses, ...] = ()
    states: tuple[AgentSpan, ...] = ()
    more_states: int = 0
    stop_cycle: int | None

    @property
    def messages_lost(self) -> int:
        return sum(self.lost.values())

    @property
    def missing_inputs(self) -> int:
        """Number of inputs that agents missed at their deadlines, without external agents."""
        return sum(misses.inputs for misses in self.misses if not misses.external)

    @property
    def old_inputs(self) -> int:
        """Number of older messages that they used instead."""
        return sum(misses.old for misses in self.misses if not misses.external)


class HealthWatch:
    """Follows a recording message by message."""

    def __init__(self, plan: RunPlan, cycles: range) -> None:
        self.states = AgentStates(plan, cycles.start)
        self._plan = plan
        # The fate of a message follows from its link and cycle, so it can be worked out again here.
        self._faults = plan.network_faults()

    def see(self, record: RecordedMessage) -> None:
        self.states.see(record)
        if self._plan.faults.rules and record.port.signal.is_cyclic:
            with suppress(InputError):  # The reader names a wrong message.
                self._see_faults(record.port, record.message())

    def health(self, run: RunReader, cycle: int) -> Health:
        """Return the health up to a cycle, without it."""
        ports, missed, external = self.states.gaps, self.states.missed, self._plan.access.external
        if run.outline.closed:
            self.states.finish(cycle)
        misses = [
            Misses(agent, missed.missing[agent].total(), missed.old[agent], *at, agent in external)
            for agent, at in missed.cycles.items()
        ]
        states = sorted(self.states.spans(), key=lambda one: one.weight, reverse=True)
        lost = Counter({str(port): gaps.lost for port, gaps in ports.items() if gaps.lost})
        return Health(
            fault_effects=tuple(self._effects(run.last_cycle)),
            faults=dict(+self._faults.tally),
            lost=dict(lost.most_common()),
            repeated=sum(gaps.repeated for gaps in ports.values()),
            misses=tuple(sorted(misses, key=lambda one: (-one.inputs, one.agent))),
            states=tuple(states[:_MOST_STATES]),
            stop_cycle=run.stop_cycle,
            more_states=len(states[_MOST_STATES:]),
        )

    def _effects(self, last_cycle: int) -> Iterator[FaultEffect]:
        for number, fault in enumerate(self._plan.faults.rules):
            if isinstance(fault, ProcessFault):
                begin_s = fault.at if isinstance(fault, Kill) else fault.at[0]
                cycle = int(begin_s * 1e9 / self._plan.timing.cycle_ns)
                came = cycle <= last_cycle
                yield FaultEffect(fault, 0, cycle, cycle) if came else FaultEffect(fault)
            else:
                act = self._faults.acts[number]
                yield FaultEffect(fault, act.messages, act.first_cycle, act.last_cycle)

    def _see_faults(self, port: Port[Message], message: Message) -> None:
        """Work out the fate of a message on its way to each listener that is not external."""
        for listener in self._plan.wiring.listeners[port]:
            if listener not in self._plan.access.external:
                self._faults.fates(port, listener, message)
