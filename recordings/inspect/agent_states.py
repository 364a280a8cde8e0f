"""The state of each agent in each cycle, by what was recorded up to its end, and its absences.

The live page and `heliarch inspect` show them. A cycle ends where the next one begins in the
recording: a message that comes later does not change what was known before.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from typing import Final, Literal, NamedTuple, TypeAlias

import msgspec

from agents.faults import Fault, Kill, incidents
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import GivenUp, Message
from bus_schemas.signals import GIVEN_UP, IMPP, TELEMETRY, Port
from bus_schemas.tree import PLANT, RECORDER, agent_name
from recordings.inspect.cut_off import Listeners
from recordings.read.gaps import MissedInputs, gaps_of_ports
from recordings.read.reader import RecordedMessage, RunReader
from recordings.read.run_clock import RunClock
from scenarios.fault_rules import fault_text

Word: TypeAlias = Literal[
    "fine",
    "not heard",
    "cut off",
    "frozen",
    "killed",
    "restarted",
    "given up",
    "not recorded",
]

How: TypeAlias = Literal["back", "restarted", "not back", "not heard", "cut off"]

_UNHEARD: Final = 2
"""After so many missed cycles in a row an agent is worth an event."""

_CAUSES: Final[dict[str, Word]] = {"kill": "killed", "freeze": "frozen"}
"""What is said of a silent agent to which a fault rule did this."""


class AgentState(msgspec.Struct, frozen=True):
    """How an agent was in a cycle.

    missed_cycles: For how many cycles up to this one nothing of it came, or it was cut off.
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


class Absence(msgspec.Struct, frozen=True):
    """An agent that was absent for some cycles; 0 of them if it only restarted.

    how: `back` as it was, `restarted` as another process, or `not back`: nothing
        of it came, and its numbers show that it published nothing. `not heard`: the
        recorder did not hear what it published. `cut off`: those who await its messages lacked
        them, or it lacked theirs. The recorder is `not heard` where it heard nobody.
    back_in: The cycle in which it was heard again, or its next process joined; None: it was not.
    cause: What a fault rule did to it.

    A real inverter is named `device c2/inv07`: it has no telemetry while it is gone.
    """

    agent: str
    first_cycle: int
    cycles: int
    back_in: int | None
    how: How = "back"
    cause: str = ""

    @property
    def end(self) -> int:
        return self.first_cycle + self.cycles

    @property
    def weight(self) -> tuple[bool, int]:
        """What it is sorted by: whether the agent came back as it was, and for how long."""
        return self.how != "back", self.cycles

    def is_near(self, other: Absence, cycles: int) -> bool:
        """Whether there are at most so many cycles between both."""
        return other.first_cycle <= self.end + cycles and self.first_cycle <= other.end + cycles

    def text(self, clock: RunClock) -> str:
        span = clock.span_text(self.first_cycle, self.end - 1) if self.cycles else ""
        if self.agent == RECORDER:
            return f"{self.agent}: recorded nothing {span}"
        if self.how == "not heard":
            return f"{self.agent}: not heard {span}, though it published"
        if self.how == "cut off":
            return f"{self.agent}: cut off {span}"
        gone = f"nothing {span}, " if span else ""
        cause = f"{self.cause}, " if self.cause else ""
        back = "" if self.back_in is None else f" in cycle {self.back_in:,}"
        return f"{self.agent}: {gone}{cause}{self.how}{back}"


class Change(NamedTuple):
    """Something that happened to an agent in a cycle, `times` times; `kind` as the page shows."""

    kind: str
    cycle: int
    agent: str
    text: str
    times: int = 1


class _Spans(list[range]):
    """Spans of cycles that follow each other; those that adjoin become one."""

    def add(self, span: range) -> None:
        if self and span.start <= self[-1].stop:
            last = self.pop()
            span = range(last.start, max(span.stop, last.stop))
        self.append(span)

    def length(self, cycle: int) -> int:
        """Return how long the span that a cycle is in had lasted by then, 0 if it is in none."""
        number = bisect_right(self, cycle, key=lambda span: span.start) - 1
        is_in = number >= 0 and cycle in self[number]
        return cycle - self[number].start + 1 if is_in else 0


class _Agent:
    """What is known of one agent.

    heard_in: The newest cycle of the run when it was last heard. In real time a message can come
        after its own cycle: `newest` is the newest cycle that the agent itself named.
    silent, cut_off: Cycles in which nothing of it came, and in which it was cut off.
    missed_in, missed: Cycles in which it missed inputs, and how many it had missed by then.
    """

    def __init__(self, first_cycle: int) -> None:
        self.heard_in = self.newest = first_cycle - 1
        self.incarnation = 0
        self.silent, self.cut_off = _Spans(), _Spans()
        self.restarts, self.missed_in, self.missed = array("q"), array("q"), array("q")
        self.given_up: int | None = None
        self.causes: list[tuple[int, Word]] = []

    def miss(self, cycle: int, inputs: int) -> None:
        self.missed_in.append(cycle)
        self.missed.append(inputs + self.missed_up_to(cycle))

    def missed_up_to(self, cycle: int) -> int:
        number = bisect_right(self.missed_in, cycle, hi=len(self.missed))
        return self.missed[number - 1] if number else 0

    def silent_cycles(self, cycle: int) -> int:
        if cycle > self.heard_in:
            return cycle - self.heard_in
        return self.silent.length(cycle)

    def cause(self, since: int, cycle: int) -> Word | Literal[""]:
        """Return what a fault rule did to it after it was last heard, in cycle `since`."""
        return next((word for at, word in reversed(self.causes) if since <= at <= cycle), "")


class AgentStates:
    """Follows a recording from its beginning, or counts a part of it from `first_cycle` on.

    `newest` is the newest cycle of the run's own agents. `changes` are what happened; whoever shows
    them takes them out. A real inverter is an agent too, `device c2/inv07`, heard by its telemetry.
    """

    def __init__(self, plan: RunPlan, first_cycle: int = 0) -> None:
        self.newest = first_cycle - 1
        self.changes = deque[Change]()
        self.gaps = gaps_of_ports(plan, first_cycle)
        self.missed = MissedInputs(plan)
        self._plan = plan
        self._first_cycle = first_cycle
        self._devices: dict[Port[Message], str] = {
            TELEMETRY.of(node): f"device {node}" for node, _ in plan.site.devices
        }
        names = (PLANT, *map(agent_name, plan.tree.nodes), *self._devices.values())
        self._agents = {name: _Agent(first_cycle) for name in names}
        self._listeners = Listeners(plan)
        self._nobody: list[range] = []
        self._absences: list[Absence] = []
        self._faults = deque(fault_changes(plan))
        for begin_s, agent, what, *_ in incidents(plan.faults.rules, plan.tree, plan.wiring):
            if what in _CAUSES and agent in self._agents:
                self._agents[agent].causes.append((_cycle_at(plan, begin_s), _CAUSES[what]))

    @property
    def agents(self) -> tuple[str, ...]:
        """The plant and the controllers, in the order of the tree."""
        return (PLANT, *map(agent_name, self._plan.tree.nodes))

    def see(self, record: RecordedMessage) -> None:
        """Take in a message, in the order of the recording."""
        port, cycle, name = record.port, record.cycle, record.port.publisher
        gaps, agent = self.gaps[port], self._agents.get(name)
        lost, restarts = gaps.lost, gaps.restarts
        gaps.see(cycle, record.sequence, record.incarnation)
        if agent is None or not 0 <= cycle < self._plan.timing.cycles:
            return
        if cycle > self.newest and name not in self._plan.access.external:
            self._begin(cycle)
        if gaps.lost > lost:
            self._note("lost", self.newest, name, "messages lost", gaps.lost - lost)
        is_number_new = gaps.restarts > restarts and port.signal is IMPP
        joined = self._joined(agent, record, is_number_new=is_number_new)
        if joined is not None:
            self._note_restart(name, agent)
        if record.incarnation >= agent.incarnation:  # A process that was replaced may go on.
            self._hear(name, cycle, joined, has_lost=gaps.lost > lost)
        if port in self._devices:
            self._hear(self._devices[port], cycle)
        if port.signal is GIVEN_UP:
            self._give_up(record)
        if keys := self.missed.see(record):
            agent.miss(self.newest, len(keys))
            self._listeners.lack(name, keys)

    def at(self, name: str, cycle: int) -> AgentState:
        agent = self._agents[name]
        silent, cut_off = agent.silent_cycles(cycle), agent.cut_off.length(cycle)
        if not cut_off and cycle == self.newest and name in self._cut_off():
            cut_off = agent.cut_off.length(cycle - 1) + 1
        missed = max(silent, cut_off)
        return AgentState(
            word=self._word(agent, name, cycle, silent, missed),
            missed_cycles=missed,
            missed_inputs=agent.missed_up_to(cycle),
            missed_now=agent.missed_up_to(cycle) - agent.missed_up_to(cycle - 1),
            restarts=bisect_right(agent.restarts, cycle),
        )

    def absences(self, end: int) -> list[Absence]:
        self._end_cycle()
        found, hold = self._absences, self._plan.control.hold_cycles
        for span in self._nobody:
            found.append(Absence(RECORDER, span.start, len(span), span.stop, "not heard"))
        for name, agent in self._agents.items():
            first, cycles = agent.newest + 1, end - agent.newest - 1
            if cycles > 1:  # A run that broke off has not completed its last cycle.
                cause = agent.cause(agent.newest, end)
                found.append(Absence(name, first, cycles, None, "not back", cause))
            known = [one for one in found if one.agent == name]
            for span in agent.cut_off:
                cut = Absence(
                    name, span.start, min(span.stop, end) - span.start, span.stop, "cut off"
                )
                if cut.cycles > hold and not any(cut.is_near(one, hold) for one in known):
                    found.append(cut)
        return found

    def _word(self, agent: _Agent, name: str, cycle: int, silent: int, missed: int) -> Word:
        if agent.given_up is not None and agent.given_up <= cycle:
            return "given up"
        if silent and any(cycle in span for span in self._nobody):
            return "not recorded"
        if silent:
            return agent.cause(cycle - silent, cycle) or "not heard"
        if missed:
            return "cut off" if missed >= _UNHEARD else "not heard"
        return self._process_word(agent, name, cycle)

    def _process_word(self, agent: _Agent, name: str, cycle: int) -> Word:
        number = bisect_right(agent.restarts, cycle)
        if number and cycle <= agent.restarts[number - 1] + self._plan.control.hold_cycles:
            return "restarted"
        return "fine"

    def _cut_off(self) -> dict[str, int]:
        newest, agents = self.newest, self._agents
        return self._listeners.cut_off(newest, lambda name: agents[name].heard_in == newest)

    def _begin(self, cycle: int) -> None:
        self._end_cycle()
        if cycle > self.newest + 1:
            self._nobody.append(range(self.newest + 1, cycle))
            self._note("gap", self.newest + 1, RECORDER, "no agent was recorded")
        self.newest = cycle
        while self._faults and self._faults[0].cycle <= cycle:
            self.changes.append(self._faults.popleft())

    def _end_cycle(self) -> None:
        cycle, cut_off = self.newest, self._cut_off()
        for name, agent in self._agents.items():
            if name in cut_off:
                agent.cut_off.add(range(cycle, cycle + cut_off[name]))
                if agent.heard_in == cycle and agent.cut_off.length(cycle) == _UNHEARD:
                    self._note("cut off", cycle, name, "cut off")
            if cycle == agent.heard_in + _UNHEARD and agent.given_up is None:
                word = agent.cause(agent.heard_in, cycle)
                self._note("not heard", cycle, name, f"not heard{f': {word}' if word else ''}")
        self._listeners.next_cycle()

    def _joined(self, agent: _Agent, record: RecordedMessage, *, is_number_new: bool) -> int | None:
        """Return the cycle in which the process joined that speaks for an agent from now on."""
        if record.incarnation > agent.incarnation:
            agent.incarnation = record.incarnation
            # Of a part of a recording: it had joined before.
            return record.incarnation if record.incarnation >= self._first_cycle else None
        return record.cycle if is_number_new else None

    def _hear(
        self, name: str, cycle: int, joined: int | None = None, *, has_lost: bool = False
    ) -> None:
        """Note that an agent is heard; `has_lost`: messages before it were not recorded."""
        agent, now = self._agents[name], self.newest
        if joined is not None or cycle > agent.newest + 1:
            self._absences += self._absence(name, agent, cycle, joined, has_lost=has_lost)
        if now > agent.heard_in + 1:
            agent.silent.add(range(agent.heard_in + 1, now))
            if now > agent.heard_in + _UNHEARD and agent.heard_in >= 0 and joined is None:
                self._note("back", now, name, "heard again")
        agent.heard_in, agent.newest = now, max(cycle, agent.newest)

    def _absence(
        self, name: str, agent: _Agent, cycle: int, joined: int | None, *, has_lost: bool
    ) -> Iterator[Absence]:
        """Yield how an agent was absent up to a cycle, or that another process of it joined."""
        gone = range(agent.newest + 1, cycle)
        if gone and has_lost:
            nobody = (
                range(max(one.start, gone.start), min(one.stop, cycle)) for one in self._nobody
            )
            if len(gone) - sum(map(len, nobody)) > self._plan.control.hold_cycles:
                yield Absence(name, gone.start, len(gone), cycle, "not heard")
            gone = gone[:0]
        if joined is None and not gone:
            return
        first, back_in = (gone.start, cycle) if gone else (joined, joined)
        assert first is not None
        how: How = "back" if joined is None else "restarted"
        cause = agent.cause(first - 1, cycle)
        yield Absence(name, first, len(gone), back_in, how, cause)

    def _note_restart(self, name: str, agent: _Agent) -> None:
        agent.restarts.append(self.newest)
        self._note("restart", self.newest, name, "restarted")

    def _give_up(self, record: RecordedMessage) -> None:
        try:
            message = record.message()
        except InputError:  # The reader names a wrong message.
            return
        assert isinstance(message, GivenUp)
        for name in message.agents:
            agent = self._agents.get(name)
            if agent is not None and agent.given_up is None:
                agent.given_up = self.newest
                self._note("given up", self.newest, name, "given up: it is not started again")

    def _note(self, kind: str, cycle: int, agent: str, text: str, times: int = 1) -> None:
        self.changes.append(Change(kind, cycle, agent, text, times))


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
