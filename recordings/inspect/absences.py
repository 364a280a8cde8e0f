"""Who was absent in a run, and in which cycles: by what is recorded, and by what listeners missed.

Three things make an agent absent. Nothing of it came, and its numbers show that it published
nothing: it was gone. Its numbers show that it did publish: the recorder did not hear it. Or most of
those who await its messages missed them, whatever the recorder heard. Where the recorder heard
nobody at all, the recorder was absent.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import Final, Literal, TypeAlias

import msgspec

from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.messages import Message
from bus_schemas.signals import TELEMETRY, Port
from bus_schemas.tree import RECORDER
from recordings.read.gaps import due_step
from recordings.read.run_clock import RunClock

_MOST_LISTED: Final = 100

_OPEN_CYCLES: Final = 1000
"""How many cycles may pass until the last listener has said what it missed."""

How: TypeAlias = Literal["back", "restarted", "standby took over", "not back", "not heard"]


class Absence(msgspec.Struct, frozen=True):
    """An agent that was absent for some cycles; 0 of them if it only restarted.

    how: `back` as it was, `restarted` as another process, replaced by its standby, `not back`, or
        `not heard`, though it published.
    back_in: The cycle in which it was heard again, or its other process joined; None: it was not.

    A real inverter is named `device c2/inv07`: it has no telemetry while it is gone.
    """

    agent: str
    first_cycle: int
    cycles: int
    back_in: int | None
    how: How = "back"

    @property
    def weight(self) -> tuple[bool, int]:
        """What it is sorted by: whether the agent came back as it was, and for how long."""
        return self.how != "back", self.cycles

    def text(self, clock: RunClock) -> str:
        last = self.first_cycle + self.cycles - 1
        span = clock.span_text(self.first_cycle, last) if self.cycles else ""
        if self.how == "not heard":
            return f"{self.agent}: not heard {span}, though it published"
        gone = f"nothing {span}, " if span else ""
        how = f"its {self.how}" if self.how.startswith("standby") else self.how
        return f"{self.agent}: {gone}{how}" + (
            "" if self.back_in is None else f" in cycle {self.back_in:,}"
        )


class Absences:
    """Follows a recording from a cycle on.

    `longest` are those that are listed; `more` others were shorter.
    """

    def __init__(self, plan: RunPlan, first_cycle: int) -> None:
        self.longest: list[Absence] = []
        self.more = 0
        self._hold = plan.control.hold_cycles
        self._standbys = plan.standbys
        self._external = plan.access.external
        self._devices: dict[Port[Message], str] = {
            TELEMETRY.of(node): f"device {node}" for node, _ in plan.site.devices
        }
        # The agents that publish in every turn, and after how many cycles.
        self._step: dict[str, int] = {}
        for port in plan.wiring.ports:
            if port.signal.logged and (step := due_step(plan, port)):
                self._step[port.publisher] = min(step, self._step.get(port.publisher, step))
        self._step |= dict.fromkeys(self._devices.values(), 1)
        self._last_cycle = dict.fromkeys(self._step, first_cycle - 1)
        # The cycle in which the process that speaks for each agent joined.
        self._joined = dict.fromkeys(self._step, max(first_cycle - 1, 0))
        self._newest = first_cycle - 1
        self._nobody: list[range] = []
        self._missed = _Missed(plan)

    def see(self, port: Port[Message], cycle: int, incarnation: int, *, has_lost: bool) -> None:
        """Take in a message; `has_lost`: messages of its port before it were not recorded."""
        agent = port.publisher
        if agent not in self._step:
            return
        if agent not in self._external:  # A device may name any cycle.
            if cycle > self._newest + 1:
                self._nobody.append(range(self._newest + 1, cycle))
            self._newest = max(cycle, self._newest)
        is_new = incarnation > self._joined[agent]
        self._joined[agent] = max(incarnation, self._joined[agent])
        self._note_until(agent, cycle, incarnation if is_new else None, has_lost=has_lost)
        if port in self._devices:
            self._note_until(self._devices[port], cycle, None)

    def miss(self, agent: str, cycle: int, keys: Iterable[str]) -> None:
        """Take in the keys that an agent missed in a cycle."""
        self._missed.see(agent, cycle, keys)

    def end(self, cycle: int) -> None:
        """Note the agents that were not back when the run ended before a cycle, and the unheard."""
        for agent, last in self._last_cycle.items():
            # A run that broke off has not completed its last cycle.
            if cycle > last + self._step[agent] + 1:
                self._note(Absence(agent, last + 1, cycle - last - 1, None, "not back"))
        for span in self._nobody:
            self._note(Absence(RECORDER, span.start, len(span), span.stop, "not heard"))
        known = list(self.longest)
        for agent, span in self._missed.spans():
            if len(span) > self._hold and not any(
                one.agent == agent
                and one.first_cycle <= span.stop + self._hold
                and span.start <= one.first_cycle + one.cycles + self._hold
                for one in known
            ):
                self._note(Absence(agent, span.start, len(span), span.stop, "not heard"))

    def _note_until(
        self, agent: str, cycle: int, joined: int | None, *, has_lost: bool = False
    ) -> None:
        """Note that an agent was absent up to a cycle, or that a new process of it joined."""
        last = self._last_cycle[agent]
        self._last_cycle[agent] = max(cycle, last)
        gone = cycle - last - 1 if cycle > last + self._step[agent] else 0
        if gone and has_lost:
            unheard = gone - sum(
                len(range(max(span.start, last + 1), min(span.stop, cycle)))
                for span in self._nobody
            )
            if unheard > self._hold:
                self._note(Absence(agent, last + 1, gone, cycle, "not heard"))
            gone = 0
        if joined is None:
            if gone:
                self._note(Absence(agent, last + 1, gone, cycle))
            return
        # Where there is a standby, a restarted process becomes the new standby.
        how: How = "standby took over" if agent in self._standbys else "restarted"
        first, back_in = (last + 1, cycle) if gone else (joined, joined)
        self._note(Absence(agent, first, gone, back_in, how))

    def _note(self, absence: Absence) -> None:
        """Keep an absence; beyond `_MOST_LISTED` the shortest are only counted."""
        self.longest.append(absence)
        if len(self.longest) > _MOST_LISTED:
            self.longest.remove(min(self.longest, key=lambda one: one.weight))
            self.more += 1


class _Missed:
    """Finds the cycles in which most of those who await an agent's messages missed them."""

    def __init__(self, plan: RunPlan) -> None:
        self._publisher = {str(port): port.publisher for port in plan.wiring.ports}
        waiting = defaultdict[str, set[str]](set)
        for agent, turns in stages_of_agents(plan).items():
            for stages in turns:
                for stage in stages:
                    for port in stage.awaits:
                        waiting[port.publisher].add(agent)
        self._most = {agent: len(listeners) // 2 + 1 for agent, listeners in waiting.items()}
        self._tolerance = plan.control.hold_cycles + plan.control.periods.longest
        self._listeners: dict[int, dict[str, set[str]]] = {}
        self._spans = defaultdict[str, list[range]](list)

    def see(self, agent: str, cycle: int, keys: Iterable[str]) -> None:
        missed = self._listeners.setdefault(cycle, {})
        for key in keys:
            missed.setdefault(self._publisher[key], set()).add(agent)
        if len(self._listeners) > _OPEN_CYCLES:
            self._close(min(self._listeners))

    def spans(self) -> Iterator[tuple[str, range]]:
        for cycle in sorted(self._listeners):
            self._close(cycle)
        for agent, spans in self._spans.items():
            for span in spans:
                yield agent, span

    def _close(self, cycle: int) -> None:
        for agent, listeners in self._listeners.pop(cycle).items():
            if len(listeners) < self._most.get(agent, 1):
                continue
            spans = self._spans[agent]
            if spans and cycle <= spans[-1].stop + self._tolerance:
                spans[-1] = range(spans[-1].start, max(cycle + 1, spans[-1].stop))
            elif len(spans) < _MOST_LISTED:
                spans.append(range(cycle, cycle + 1))
