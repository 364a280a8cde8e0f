"""The state of each agent in each cycle, by what was recorded up to the end of that cycle.

The live page and `heliarch inspect --cycle` show it. A cycle ends where the next one begins in the
recording: a message that comes later does not change what was known before.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Iterator
from typing import Final, Literal, NamedTuple, TypeAlias

import msgspec

from agents.faults import Fault, Kill, incidents
from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.errors import InputError
from bus_schemas.messages import GivenUp, Message
from bus_schemas.signals import GIVEN_UP, IMPP, TELEMETRY, Port
from bus_schemas.tree import PLANT, ROOT, agent_name, parent_of
from recordings.read.gaps import MissedInputs, PortGaps
from recordings.read.reader import RecordedMessage, RunReader
from scenarios.fault_rules import fault_text

Word: TypeAlias = Literal[
    "fine",
    "not heard",
    "cut off",
    "frozen",
    "killed",
    "restarted",
    "standby in charge",
    "given up",
    "not recorded",
]

_UNHEARD: Final = 2
"""After so many missed cycles in a row an agent is worth an event."""


class AgentState(msgspec.Struct, frozen=True):
    """How an agent was in a cycle.

    missed_cycles: For how many cycles up to this one nothing of it came, or its parent or half of
        those who await its messages missed them.
    missed_inputs: Inputs that it missed at its deadlines, so far and in this cycle.
    restarts: How often another process had taken its place by then.
    """

    word: Word
    missed_cycles: int
    missed_inputs: int
    missed_now: int
    restarts: int

    @property
    def level(self) -> int:
        """0: all well; 1: one cycle was missed; 2: several were, or the agent was given up."""
        return 2 if self.word == "given up" else min(self.missed_cycles, 2)

    def text(self) -> str:
        """Return it as tables show it: `frozen for 3`, `fine`."""
        lasts = self.missed_cycles > 1 and self.word != "given up"
        return f"{self.word} for {self.missed_cycles:,}" if lasts else self.word

    def document(self) -> dict[str, str | int]:
        return {**msgspec.structs.asdict(self), "level": self.level}


class Change(NamedTuple):
    """Something that happened to an agent in a cycle, `times` times; `kind` as the page shows."""

    kind: str
    cycle: int
    agent: str
    text: str
    times: int = 1


class AgentStates:
    """Follows a recording from its beginning.

    `newest` is the newest cycle of the run's own agents. `changes` are what happened; whoever shows
    them takes them out. A real inverter is an agent too, `device c2/inv07`, heard by its telemetry.
    """

    def __init__(self, plan: RunPlan) -> None:
        self.newest = -1
        self.changes = deque[Change]()
        self.agents = (PLANT, *map(agent_name, plan.tree.nodes))
        self._plan = plan
        self._device: dict[Port[Message], str] = {
            TELEMETRY.of(node): f"device {node}" for node, _ in plan.site.devices
        }
        self._last = dict.fromkeys((*self.agents, *self._device.values()), -1)
        self._silent: dict[str, list[range]] = {agent: [] for agent in self._last}
        self._nobody: list[range] = []
        self._restarts = defaultdict[str, list[int]](list)
        self._incarnation: dict[str, int] = {}
        self._given_up: dict[str, int] = {}
        self._gaps = defaultdict[Port[Message], PortGaps](PortGaps)
        self._missed = MissedInputs(plan)
        self._missed_in = defaultdict[str, _Counts](_Counts)
        self._unheard = _Unheard(plan)
        self._faults = list(fault_changes(plan))
        self._causes = defaultdict[str, list[tuple[int, Word]]](list)
        for begin_s, agent, what, *_ in incidents(plan.faults.rules, plan.tree, plan.wiring):
            word = _CAUSES.get(what)
            if word is not None:
                self._causes[agent].append((_cycle_at(plan, begin_s), word))

    def see(self, record: RecordedMessage) -> None:
        """Take in a message, in the order of the recording."""
        port, cycle, agent = record.port, record.cycle, record.port.publisher
        if agent not in self._last or not 0 <= cycle < self._plan.timing.cycles:
            return
        if cycle > self.newest and agent not in self._plan.access.external:
            self._begin(cycle)
        gaps = self._gaps[port]
        lost, restarts = gaps.lost, gaps.restarts
        gaps.see(cycle, record.sequence, record.incarnation)
        if gaps.lost > lost:
            self._note("lost", self.newest, agent, "messages lost", gaps.lost - lost)
        if record.incarnation >= self._incarnation.get(agent, 0):
            self._incarnation[agent] = record.incarnation
            if gaps.restarts > restarts and port.signal is IMPP:
                self._note_restart(agent)
            self._hear(agent)
        if port in self._device:
            self._hear(self._device[port])
        if port.signal is GIVEN_UP:
            self._give_up(record)
        self._note_missing(record)

    def at(self, agent: str, cycle: int) -> AgentState:
        """Return how an agent was in a cycle that has been recorded."""
        silent = self._silent_cycles(agent, cycle)
        missed = max(silent, self._unheard.run(agent, cycle))
        restarts = bisect_right(self._restarts[agent], cycle)
        counts = self._missed_in[agent]
        return AgentState(
            word=self._word(agent, cycle, silent, missed),
            missed_cycles=missed,
            missed_inputs=counts.up_to(cycle),
            missed_now=counts.up_to(cycle) - counts.up_to(cycle - 1),
            restarts=restarts,
        )

    def _word(self, agent: str, cycle: int, silent: int, missed: int) -> Word:
        if self._given_up.get(agent, cycle + 1) <= cycle:
            return "given up"
        if silent and any(cycle in span for span in self._nobody):
            return "not recorded"
        if silent:
            return self._cause(agent, cycle - silent, cycle) or "not heard"
        if missed:
            return "cut off" if missed >= _UNHEARD else "not heard"
        return self._process_word(agent, cycle)

    def _process_word(self, agent: str, cycle: int) -> Word:
        """Return which process speaks for an agent that is heard."""
        restarts = self._restarts[agent]
        number = bisect_right(restarts, cycle)
        if number and agent in self._plan.standbys:
            return "standby in charge"
        if number and cycle <= restarts[number - 1] + self._plan.control.hold_cycles:
            return "restarted"
        return "fine"

    def _cause(self, agent: str, since: int, cycle: int) -> Word | None:
        """Return what a fault rule did to an agent that was last heard in cycle `since`."""
        words = [word for begin, word in self._causes[agent] if since <= begin <= cycle]
        return words[-1] if words else None

    def _silent_cycles(self, agent: str, cycle: int) -> int:
        """Return for how many cycles up to one nothing of an agent came."""
        if cycle > self._last[agent]:
            return cycle - self._last[agent]
        return _length(self._silent[agent], cycle)

    def _begin(self, cycle: int) -> None:
        """Begin a cycle, which ends the one before it."""
        if self.newest >= 0:
            self._note_silent(self.newest)
        if cycle > self.newest + 1:
            self._nobody.append(range(self.newest + 1, cycle))
            self._note("gap", self.newest + 1, "recorder", "no agent was recorded")
        self.newest = cycle
        while self._faults and self._faults[0].cycle <= cycle:
            self.changes.append(self._faults.pop(0))

    def _hear(self, agent: str) -> None:
        last, now = self._last[agent], self.newest
        if now > last + 1:
            self._silent[agent].append(range(last + 1, now))
            if now > last + _UNHEARD and last >= 0 and now not in self._restarts[agent][-1:]:
                self._note("back", now, agent, "heard again")
        self._last[agent] = now

    def _note_silent(self, cycle: int) -> None:
        for agent, last in self._last.items():
            if cycle == last + _UNHEARD and agent not in self._given_up:
                word = self._cause(agent, last, cycle)
                self._note("not heard", cycle, agent, f"not heard{f': {word}' if word else ''}")

    def _note_restart(self, agent: str) -> None:
        self._restarts[agent].append(self.newest)
        is_standby = agent in self._plan.standbys
        kind, text = (
            ("takeover", "its standby took over") if is_standby else ("restart", "restarted")
        )
        self._note(kind, self.newest, agent, text)

    def _give_up(self, record: RecordedMessage) -> None:
        try:
            message = record.message()
        except InputError:  # The reader names a wrong message.
            return
        assert isinstance(message, GivenUp)
        for agent in message.agents:
            if agent not in self._given_up:
                self._given_up[agent] = self.newest
                self._note("given up", self.newest, agent, "given up: it is not started again")

    def _note_missing(self, record: RecordedMessage) -> None:
        """Note the inputs that an agent missed, and whose messages others miss by now."""
        keys, agent, cycle = self._missed.see(record), record.port.publisher, record.cycle
        if keys:
            self._missed_in[agent].add(self.newest, len(keys))
        for key in keys:
            publisher = self._unheard.see(agent, cycle, key)
            if publisher is None or self._last[publisher] < cycle - 1:
                continue  # Most hear it, or it is silent, which is another event.
            if self._unheard.run(publisher, cycle) == _UNHEARD:
                self._note("cut off", cycle, publisher, "not heard by those who await it")

    def _note(self, kind: str, cycle: int, agent: str, text: str, times: int = 1) -> None:
        self.changes.append(Change(kind, cycle, agent, text, times))


class _Counts:
    """Counts in cycles that do not decrease."""

    def __init__(self) -> None:
        self._cycles: list[int] = []
        self._totals: list[int] = []

    def add(self, cycle: int, count: int) -> None:
        self._cycles.append(cycle)
        self._totals.append(count + (self._totals[-1] if self._totals else 0))

    def up_to(self, cycle: int) -> int:
        number = bisect_right(self._cycles, cycle)
        return self._totals[number - 1] if number else 0


class _Unheard:
    """The cycles in which an agent's parent, or half of those who await it, missed its messages."""

    def __init__(self, plan: RunPlan) -> None:
        self._publisher = {str(port): port.publisher for port in plan.wiring.ports}
        self._parent = {
            agent_name(node): agent_name(parent_of(node))
            for node in plan.tree.nodes
            if node != ROOT
        }
        waiting = defaultdict[str, set[str]](set)
        for agent, turns in stages_of_agents(plan).items():
            for port in (port for stages in turns for stage in stages for port in stage.awaits):
                waiting[port.publisher].add(agent)
        self._half = {agent: len(listeners) / 2.0 for agent, listeners in waiting.items()}
        self._missed_by: dict[str, tuple[int, set[str]]] = {}
        self._spans = defaultdict[str, list[range]](list)

    def see(self, listener: str, cycle: int, key: str) -> str | None:
        """Take in a key that a listener missed; return its publisher if that is unheard by now."""
        publisher = self._publisher[key]
        known, listeners = self._missed_by.get(publisher, (-1, set[str]()))
        if cycle != known:
            listeners = set()
            self._missed_by[publisher] = cycle, listeners
        listeners.add(listener)
        is_unheard = (
            listener == self._parent.get(publisher) or len(listeners) >= self._half[publisher]
        )
        return publisher if is_unheard and self._add(publisher, cycle) else None

    def run(self, agent: str, cycle: int) -> int:
        """Return for how many cycles up to one an agent was unheard."""
        return _length(self._spans[agent], cycle)

    def _add(self, publisher: str, cycle: int) -> bool:
        """Note a cycle; return whether it is new."""
        spans = self._spans[publisher]
        if spans and cycle < spans[-1].stop:
            return False
        if spans and cycle == spans[-1].stop:
            spans[-1] = range(spans[-1].start, cycle + 1)
        else:
            spans.append(range(cycle, cycle + 1))
        return True


def _length(spans: list[range], cycle: int) -> int:
    """Return how long the span that a cycle is in had lasted by then, 0 if it is in none."""
    number = bisect_right(spans, cycle, key=lambda span: span.start) - 1
    return cycle - spans[number].start + 1 if number >= 0 and cycle in spans[number] else 0


_CAUSES: Final[dict[str, Word]] = {"kill": "killed", "freeze": "frozen"}
"""What is said of a silent agent to which a fault rule did this."""


def states_at(run: RunReader, cycle: int) -> AgentStates:
    """Follow a recording to the end of a cycle."""
    states = AgentStates(run.plan)
    for record in run.records(cycles=range(cycle + 2)):
        states.see(record)
        if states.newest > cycle:
            break
    return states


def _cycle_at(plan: RunPlan, time_s: float) -> int:
    return int(time_s * 1e9 / plan.timing.cycle_ns)


def fault_changes(plan: RunPlan) -> Iterator[Change]:
    """Yield what the fault rules of a run do and when, in the order of time."""
    yield from sorted(
        (
            Change("fault", _cycle_at(plan, begin_s), "fault", text)
            for fault in plan.faults.rules
            for begin_s, text in _moments(fault)
        ),
        key=lambda change: change.cycle,
    )


def _moments(fault: Fault) -> Iterator[tuple[float, str]]:
    text = fault_text(fault)
    if isinstance(fault, Kill):
        yield fault.at, text
    elif fault.at is None:
        yield 0.0, text
    else:
        yield fault.at[0], f"begins: {text}"
        yield fault.at[1], f"ends: {text}"
