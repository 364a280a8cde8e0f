"""When agents were absent, cut off or given up, as page, `heliarch inspect` and report show it.

It follows from cycles, sequence numbers and the inputs that agents missed. The order in which
messages were recorded, and when, says nothing: a recorder can be late.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Final, Literal, NamedTuple, TypeAlias

import msgspec
from msgspec import structs

from agents.faults import Fault, Freeze, Kill, incidents
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import GivenUp, Message
from bus_schemas.signals import DISPATCH, GIVEN_UP, IMPP, PRODUCTION, TELEMETRY, Port
from bus_schemas.tree import PLANT, RECORDER, ROOT, agent_name
from recordings.inspect.cut_off import Listeners
from recordings.read.gaps import MissedInputs, Stretch, gaps_of_ports
from recordings.read.reader import RecordedMessage, RunReader, most_disorder
from recordings.read.run_clock import RunClock
from scenarios.fault_rules import fault_text

Kind: TypeAlias = Literal["absent", "cut off", "given up"]

BY_RECORDER: Final = "from the recorder"

_NOTABLE_CYCLES: Final = {"absent": 2, "cut off": 5, "given up": 1}
"""Shorter spans are no events: single lost messages count as missed inputs."""

_CAUSES: Final = {"kill": "killed", "freeze": "frozen"}


class AgentSpan(msgspec.Struct, frozen=True):
    """Cycles in which an agent was `absent`, `cut off` or `given up`.

    kind: `absent`: it published nothing; for 0 cycles if its process was only replaced. `cut off`:
        those who await its messages lacked them, or it lacked theirs, or the recorder did.
        `given up`: it is not started again.
    cause: What a fault rule did to it: `killed`, `frozen`; or `from the recorder`.
    is_restarted: Whether another process of it followed.
    back_in: The cycle in which it was heard again, or its other process joined; None: it was not.

    A real inverter is named `device c2/inv07`: it has no telemetry while it is gone. The recorder
    is cut off where it heard nobody.
    """

    agent: str
    kind: Kind
    first_cycle: int
    cycles: int
    cause: str = ""
    is_restarted: bool = False
    back_in: int | None = None

    @property
    def end(self) -> int:
        return self.first_cycle + self.cycles

    @property
    def is_unrecorded_plant(self) -> bool:
        """Whether the recorder did not hear the plant."""
        return self.agent == RECORDER or (self.agent == PLANT and self.cause == BY_RECORDER)

    @property
    def weight(self) -> tuple[bool, bool, int]:
        """Key of sorting: agents that came back as they were last, and short spans last."""
        is_lasting = self.kind != "absent" or self.is_restarted or self.back_in is None
        return self.is_unrecorded_plant, is_lasting, self.cycles

    @property
    def is_event(self) -> bool:
        return self.is_restarted or self.cycles >= _NOTABLE_CYCLES[self.kind]

    def what(self) -> str:
        joint = " " if self.cause == BY_RECORDER else ", "
        return joint.join(filter(None, (self.kind, self.cause)))

    def return_text(self) -> str:
        return "restarted" if self.is_restarted else "heard again"

    def text(self, clock: RunClock) -> str:
        back = "" if self.back_in is None else f"{self.return_text()} in cycle {self.back_in:,}"
        if not self.cycles:
            return f"{self.agent}: {', '.join(filter(None, (self.cause, back)))}"
        span = clock.span_text(self.first_cycle, self.end - 1)
        return f"{self.agent}: {self.what()} {span}, {back or 'to the end'}"


class AgentState(msgspec.Struct, frozen=True):
    """How an agent was in a cycle.

    kind: `fine`, or the kind of the span that the cycle is in.
    cycles: For how many cycles up to this one the span had lasted.
    missed_inputs: Inputs that it missed at its deadlines, so far and in this cycle.
    restarts: How often another process had taken its place by then.
    """

    kind: Kind | Literal["fine"]
    cause: str
    cycles: int
    missed_inputs: int
    missed_now: int
    restarts: int

    @property
    def level(self) -> int:
        """0: all well; 1: one cycle was missed; 2: several were, or the agent was given up."""
        return 2 if self.kind == "given up" else min(self.cycles, 2)

    def text(self) -> str:
        if self.kind in {"fine", "given up"}:
            return self.kind
        cause = self.cause if self.cause in _CAUSES.values() else ""
        return f"{self.kind} for {self.cycles:,}{', ' * bool(cause)}{cause}"

    def document(self) -> dict[str, str | int]:
        return {**structs.asdict(self), "level": self.level, "text": self.text()}


class Change(NamedTuple):
    """An event of an agent in a cycle; `kind` as on the page."""

    kind: str
    cycle: int
    agent: str
    text: str


_FINE: Final = AgentState("fine", "", 0, 0, 0, 0)


class AgentStates:
    """Takes in the messages of a recording, in any order; tells the states of agents from them.

    While a run goes on, an agent that is not heard counts as absent from the first cycle in which
    its listeners lacked it. After `finish`, it is absent up to the run's end.

    `newest` is the newest cycle of the run's own agents.
    """

    def __init__(self, plan: RunPlan) -> None:
        self.newest = -1
        self.gaps = gaps_of_ports(plan)
        self.missed = MissedInputs(plan)
        self._plan = plan
        self._end: int | None = None
        self._disorder = most_disorder(plan)
        devices: dict[Port[Message], str] = {
            TELEMETRY.of(node): f"device {node}" for node, _ in plan.site.devices
        }
        self._agent_of: dict[Port[Message], str] = {
            DISPATCH.of(ROOT): PLANT,
            **{IMPP.of(node): agent_name(node) for node in plan.tree.nodes},
            **devices,
        }
        """The agents, each by the one signal that it sends in every cycle."""
        self._port_of = {agent: port for port, agent in self._agent_of.items()}
        self._listeners = Listeners(
            plan, {port: devices.get(port, port.publisher) for port in plan.wiring.ports}
        )
        # The cycle of each missed input, in order.
        self._missed_in = defaultdict[str, list[int]](list)
        self._given_up: dict[str, int] = {}
        self._causes = defaultdict[str, list[tuple[int, str]]](list)
        for begin_s, agent, what, *_ in incidents(plan.faults.rules, plan.tree, plan.wiring):
            if what in _CAUSES:
                self._causes[agent].append((_cycle_at(plan, begin_s), _CAUSES[what]))
        self._lacked: dict[int, dict[str, set[str]]] = {}
        self._judged: dict[int, dict[str, int]] = {}
        self._cut_off = defaultdict[str, dict[int, int]](dict)
        self._spans: dict[str, list[AgentSpan]] = {}
        self._changed_cycles: set[int] = set()
        self._changed = set(self._port_of)

    @property
    def agents(self) -> tuple[str, ...]:
        return (PLANT, *map(agent_name, self._plan.tree.nodes))

    def see(self, record: RecordedMessage) -> None:
        port, cycle = record.port, record.cycle
        goes_on = self.gaps[port].see(cycle, record.sequence, record.incarnation)
        if not 0 <= cycle < self._plan.timing.cycles:
            return
        if port in self._agent_of:
            self._hear(self._agent_of[port], cycle, goes_on=goes_on)
        elif port.signal is GIVEN_UP:
            self._give_up(record)
        if keys := self.missed.see(record):
            name = port.publisher
            for _ in keys:
                insort(self._missed_in[name], cycle)
            lacked = self._lacked.setdefault(cycle, {}).setdefault(name, set())
            lacked |= self._listeners.publishers(keys)
            self._changed_cycles.add(cycle)

    def end_cycle(self, stop_cycle: int | None) -> int:
        """Return the first cycle after a run; by its last production if that is not recorded."""
        return self.gaps[PRODUCTION.of(ROOT)].newest + 1 if stop_cycle is None else stop_cycle

    def finish(self, end: int) -> None:
        """Note that all messages of the cycles before one have come."""
        self._end = end
        self._changed.update(self._port_of)

    def at(self, name: str, cycle: int) -> AgentState:
        spans = self._spans_of(name)
        if not spans and name not in self._missed_in:
            return _FINE  # Of thousands of agents nearly all.
        missed = self._missed_in[name]
        so_far = bisect_right(missed, cycle)
        span = next((one for one in spans if one.first_cycle <= cycle < one.end), None)
        return AgentState(
            kind=span.kind if span else "fine",
            cause=span.cause if span else "",
            cycles=cycle - span.first_cycle + 1 if span else 0,
            missed_inputs=so_far,
            missed_now=so_far - bisect_left(missed, cycle),
            restarts=sum(
                one.is_restarted and one.back_in is not None and one.back_in <= cycle
                for one in spans
            ),
        )

    def spans(self) -> list[AgentSpan]:
        """Return the spans that are events, by agents in the order of the tree."""
        nobody = self._nobody()
        found = [
            AgentSpan(RECORDER, "cut off", span.start, len(span), back_in=span.stop)
            for span in nobody
        ]
        for name in self._port_of:
            for span in self._spans_of(name):
                is_recorders = span.cause == BY_RECORDER and any(
                    one.start <= span.first_cycle and span.end <= one.stop for one in nobody
                )
                if span.is_event and not is_recorders:
                    found.append(span)
        return found

    def changes(self) -> Iterator[Change]:
        """Yield begin and end of each such span, and the faults so far."""
        for span in self.spans():
            if span.cycles:
                yield Change(span.kind, span.first_cycle, span.agent, span.what())
            if span.back_in is not None and (self._end is None or span.back_in < self._end):
                kind = "restart" if span.is_restarted else "back"
                yield Change(kind, span.back_in, span.agent, span.return_text())
        for change in fault_changes(self._plan):
            if change.cycle <= self.newest:
                yield change

    def _hear(self, name: str, cycle: int, *, goes_on: bool) -> None:
        is_external = name in self._plan.access.external
        if not goes_on or is_external:
            self._changed.add(name)
        if cycle in self._lacked:
            self._changed_cycles.add(cycle)
            self._changed.add(name)
        if cycle > self.newest and not is_external:
            self.newest = cycle

    def _give_up(self, record: RecordedMessage) -> None:
        try:
            message = record.message()
        except InputError:  # The reader names a wrong message.
            return
        assert isinstance(message, GivenUp)
        for name in message.agents:
            self._given_up[name] = min(message.cycle, self._given_up.get(name, message.cycle))
            self._changed.add(name)

    def _judge(self) -> None:
        """Work out anew which agents are cut off in the changed cycles."""
        for cycle in self._changed_cycles:
            heard = {name for name, port in self._port_of.items() if self.gaps[port].has(cycle)}
            found = self._listeners.cut_off(cycle, self._lacked[cycle], heard)
            before = self._judged.get(cycle, {})
            for name in before.keys() - found.keys():
                del self._cut_off[name][cycle]
            for name, cycles in found.items():
                self._cut_off[name][cycle] = cycles
            self._changed.update(before, found)
            self._judged[cycle] = found
        self._changed_cycles.clear()

    def _spans_of(self, name: str) -> list[AgentSpan]:
        """Return all spans of an agent in order; a span of 0 cycles is a restart."""
        self._judge()
        if name in self._changed:
            self._changed.discard(name)
            spans = [*self._absences(name)]
            gone = {cycle for one in spans for cycle in range(one.first_cycle, one.end)}
            spans += self._cuts(name, gone)
            spans = list(self._until_given_up(name, spans))
            self._spans[name] = sorted(spans, key=lambda one: (one.first_cycle, one.cycles))
        return self._spans[name]

    @property
    def _limit(self) -> int:
        return self.newest + 1 if self._end is None else self._end

    def _stretches(self, name: str) -> Iterator[Stretch]:
        for one in self.gaps[self._port_of[name]].stretches():
            if one.first < self._limit:
                yield one._replace(last=min(one.last, self._limit - 1))

    def _absences(self, name: str) -> Iterator[AgentSpan]:
        before = Stretch(0, -1, 0)
        for one in self._stretches(name):
            gone, begin = range(before.last + 1, one.first), one.first
            if one.is_anew and one.incarnation > before.incarnation:
                begin = one.incarnation
            if one.lost:  # How long it had published nothing is not known.
                gone = range(begin, begin)
            if gone or one.is_anew:
                first, back_in = (gone.start, one.first) if gone else (begin, begin)
                cause = self._cause(name, before.last, one.first)
                yield AgentSpan(name, "absent", first, len(gone), cause, one.is_anew, back_in)
            before = one
        gone = self._gone_at_last(name, before.last)
        if gone:
            cause = self._cause(name, before.last, gone.stop)
            yield AgentSpan(name, "absent", gone.start, len(gone), cause)

    def _gone_at_last(self, name: str, last: int) -> range:
        """Return the cycles after an agent was last heard, as far as known."""
        if self._end is not None or name in self._given_up:
            gone = range(last + 1, self._limit)
            # A run that broke off has not completed its last cycle.
            return gone if len(gone) > 1 or name in self._given_up else gone[:0]
        lacked = [cycle for cycle in self._cut_off[name] if last < cycle < self._limit]
        return range(min(lacked), max(lacked) + 1) if lacked else range(0)

    def _cuts(self, name: str, gone: set[int]) -> Iterator[AgentSpan]:
        heard_by_none = {
            cycle + more for cycle, cycles in self._cut_off[name].items() for more in range(cycles)
        }
        found = sorted((heard_by_none | self._unrecorded(name)) - gone)
        for span in _ranges(cycle for cycle in found if cycle < self._limit):
            cause = "" if heard_by_none.intersection(span) else BY_RECORDER
            wait = self._plan.control.hold_cycles if self._end is None else 0
            back_in = span.stop if span.stop + wait < self._limit else None
            yield AgentSpan(name, "cut off", span.start, len(span), cause, back_in=back_in)

    def _unrecorded(self, name: str) -> set[int]:
        """Return cycles of which sequence numbers show messages that are not recorded."""
        found = set[int]()
        settled = self.newest - self._disorder if self._end is None else self._end
        for before, after in pairwise(self._stretches(name)):
            if after.lost and after.first <= settled:
                found.update(range(before.last + 1, after.first))
        return found

    def _until_given_up(self, name: str, spans: Iterable[AgentSpan]) -> Iterator[AgentSpan]:
        end = self._given_up.get(name)
        if end is None:
            yield from spans
            return
        for span in spans:
            if span.first_cycle < end:
                cycles = min(span.cycles, end - span.first_cycle)
                yield structs.replace(span, cycles=cycles)
        yield AgentSpan(name, "given up", end, max(self._limit - end, 1))

    def _nobody(self) -> list[range]:
        """Return the cycles in which no agent was recorded, though the plant published."""
        own = [
            self.gaps[port]
            for name, port in self._port_of.items()
            if name not in self._plan.access.external
        ]
        found = sorted(self._unrecorded(PLANT))
        return list(_ranges(cycle for cycle in found if not any(one.has(cycle) for one in own)))

    def _cause(self, name: str, since: int, cycle: int) -> str:
        causes = reversed(self._causes[name])
        return next((cause for at, cause in causes if since <= at <= cycle), "")


def states_of(run: RunReader) -> AgentStates:
    """Follow a recording to its end."""
    states = AgentStates(run.plan)
    for record in run.records():
        states.see(record)
    if run.outline.closed:
        states.finish(states.end_cycle(run.stop_cycle))
    return states


def _ranges(cycles: Iterable[int]) -> Iterator[range]:
    """Join cycles that follow each other to spans."""
    span = range(0)
    for cycle in cycles:
        if span and cycle == span.stop:
            span = range(span.start, cycle + 1)
            continue
        if span:
            yield span
        span = range(cycle, cycle + 1)
    if span:
        yield span


def _cycle_at(plan: RunPlan, time_s: float) -> int:
    return int(time_s * 1e9 / plan.timing.cycle_ns)


def fault_changes(plan: RunPlan) -> Iterator[Change]:
    """Yield the faults of a run in the order of time, without the end of a freeze."""
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
        if not isinstance(fault, Freeze):
            yield fault.at[1], f"ends: {text}"
