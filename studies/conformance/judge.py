"""Judges the recording of a launch: the device's answers beside those of our own agent.

Our own agent hears what the device was sent, at the recorded times. `missing` in the device's
messages does not count: it is under test.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from agents.cycle import stage_of
from agents.device_faults import DeviceFaults
from agents.driver import Driver
from agents.loop import Loop
from agents.plan import RunPlan
from agents.team import controller
from bus_schemas.bus import Arrival
from bus_schemas.codec import UNREADABLE
from bus_schemas.messages import Message, Run
from bus_schemas.signals import Port
from recordings.read.reader import RunReader
from recordings.record.plausibility import out_of_range
from recordings.verify.comparison import Equality
from studies.conformance.requirements import Failure

_OF_THE_HEAD: Final = ("source", "sim_time_ns", "incarnation")
_CLOCKS_DIFFER_NS: Final = 50_000_000
_OLDEST_NS: Final = 10_000_000_000
_ON_ITS_WAY_NS: Final = 150_000_000
"""A message that was heard longer after its publish time was held up by its sender."""


class Answer(NamedTuple):
    """A message of the device, and when it was heard, or one of ours; monotonic clock."""

    message: Message
    heard_ns: int


@dataclass
class DeviceRun:
    """What was recorded of a launch with a device.

    cycles: How many took place; of a launch that failed, the last one may be incomplete.
    inputs: What the device was sent, in the order of time.
    slow_cycle: The first cycle in which an input went out too late to judge; None: none did.
    """

    plan: RunPlan
    agent: str
    start_ns: int = 0
    cycles: int = 0
    inputs: list[Arrival] = field(default_factory=list)
    answers: dict[tuple[Port[Message], int], list[Answer]] = field(default_factory=dict)
    slow_cycle: int | None = None

    @classmethod
    def of(cls, folder: Path, agent: str) -> DeviceRun:
        with RunReader(folder) as reader:
            found = cls(reader.plan, agent)
            heard, faults = found.plan.wiring.heard[agent], found.plan.faults.device
            offset_ns = 0  # From the monotonic clock to that of the recording.
            for record in reader.records():
                port, message = record.port, record.message()
                if port.publisher == agent:
                    answer = Answer(message, record.log_time_ns - offset_ns)
                    found.answers.setdefault((port, message.cycle), []).append(answer)
                    continue
                offset_ns = record.publish_time_ns - message.publish_time_ns
                if isinstance(message, Run):
                    if message.state == "start":
                        found.start_ns = message.start_time_ns
                elif port in heard:
                    found._add_input(DeviceFaults(faults), port, message)
            last_cycle = reader.last_cycle
            found.cycles = last_cycle + 1 if reader.stop_cycle is None else reader.stop_cycle
        found.inputs.sort(key=lambda arrival: arrival.time_ns)
        return found

    def inputs_of(self, cycle: int) -> dict[str, list[dict[str, Any]]]:
        """Return what the device was sent of a cycle, by key; copies in the order of time."""
        found: dict[str, list[dict[str, Any]]] = {}
        for port, message in ((one.port, one.message) for one in self.inputs):
            if message.cycle == cycle:
                found.setdefault(str(port), []).append(msgspec.to_builtins(message))
        return found

    def time_ns(self, cycle: float) -> int:
        return self.start_ns + round(cycle * self.plan.timing.cycle_wall_ns)

    def times_ns(self, port: Port[Message], cycle: int) -> tuple[int, int]:
        """Return by when a message is published, and up to when its listener waits for it."""
        stage, deadlines = stage_of(port, self.plan.tree), self.plan.deadlines
        close_ns = self.time_ns(cycle) + deadlines.deadline_ns(port.publisher, stage)
        return close_ns, close_ns + deadlines.room_ns(port.publisher, stage)

    def has_begun(self, cycle: int) -> bool:
        """Whether the device heard that a cycle began: without a clock it only learns it so."""
        first = controller(self.plan, self.agent).stages(cycle)[0]
        return self.plan.timing.lockstep or any(
            one.message.cycle == cycle and one.port in first.awaits
            for one in self.inputs
            if one.time_ns < self.time_ns(cycle + 1)
        )

    def late_ms(self, port: Port[Message], cycle: int, answer: Answer, mine: Answer) -> float:
        """Return how much later than ours an answer came, if its listeners did not wait; else 0."""
        came_ns, (_, limit_ns) = answer.message.publish_time_ns, self.times_ns(port, cycle)
        if not answer.heard_ns - _ON_ITS_WAY_NS < came_ns <= answer.heard_ns:
            came_ns = answer.heard_ns
        is_awaited = self.plan.wiring.listeners[port] and not self.plan.timing.lockstep
        return (came_ns - mine.heard_ns) / 1e6 if is_awaited and came_ns > limit_ns else 0.0

    def _add_input(self, faults: DeviceFaults, port: Port[Message], message: Message) -> None:
        cycle, sent_ns = message.cycle, message.publish_time_ns
        for at, payload in faults.sent(port, message):
            time_ns = max(sent_ns, self.time_ns(cycle + at)) if at else sent_ns
            with suppress(*UNREADABLE):
                copy = port.signal.decode(payload)
                self.inputs.append(Arrival(self.agent, port, copy, time_ns))
        is_late = sent_ns > sum(self.times_ns(port, cycle)) / 2
        if is_late and not self.plan.timing.lockstep and self.slow_cycle is None:
            self.slow_cycle = cycle


class _Ours:
    """Our own agent, which joins in a cycle: its bus, and what it publishes."""

    def __init__(self, recorded: DeviceRun, joins_in: int) -> None:
        self.sent: dict[tuple[Port[Message], int], Answer] = {}
        self._now_ns = recorded.start_ns
        self._left = deque(one for one in recorded.inputs if one.message.cycle >= joins_in)
        loop = Loop(controller(recorded.plan, recorded.agent), recorded.plan)
        loop.begin(recorded.start_ns, recorded.time_ns(joins_in), joins_in)
        for _ in Driver([loop], self, lambda: self._now_ns).run():
            is_stuck = loop.deadline_ns is None and not self._left
            if is_stuck or loop.cycle >= recorded.cycles:
                return

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        self.sent[port, message.cycle] = Answer(message, now_ns)

    def receive(self, until_ns: int | None, wanted: int = 1) -> Sequence[Arrival]:
        if self._left and (until_ns is None or self._left[0].time_ns <= until_ns):
            arrival = self._left.popleft()
            self._now_ns = max(self._now_ns, arrival.time_ns)
            return (arrival,)
        self._now_ns = max(self._now_ns, until_ns or 0)
        return ()


def judge(recorded: DeviceRun, equality: Equality, rejoins_in: int | None = None) -> list[Failure]:
    """Return what is wrong with the answers of a device; in `rejoins_in` a new process joins."""
    found: list[Failure] = []
    ours, not_judged = _Ours(recorded, 0).sent, range(0)
    if rejoins_in is not None:
        joined = min((cycle for _, cycle in recorded.answers if cycle >= rejoins_in), default=None)
        if joined is None:
            found.append(Failure("restart", "no answer of a new process", rejoins_in))
            joined = recorded.cycles
        # It may have joined before all its links were open.
        not_judged = range(rejoins_in, joined + 2 * (joined > rejoins_in))
        ours = {place: one for place, one in ours.items() if place[1] < rejoins_in}
        ours |= _Ours(recorded, joined).sent
    sequences: dict[tuple[Port[Message], int], int] = {}
    for port, cycle in sorted(ours.keys() | recorded.answers, key=lambda place: place[1]):
        answers, where = recorded.answers.get((port, cycle), []), f"cycle {cycle}, {port}"
        for answer in answers[:1]:
            process, number = (port, answer.message.incarnation), answer.message.sequence
            if number != (due := sequences.get(process, 0)):
                text = f"{where}, sequence: expected {due}, got {number}"
                found.append(Failure("head", text, cycle, str(port)))
            sequences[process] = number + 1
        if port.signal.is_cyclic and cycle not in not_judged:
            mine = ours.get((port, cycle))
            for of, why in _wrong(recorded, equality, port, cycle, mine, answers):
                found.append(Failure(of, f"{where}, {why}", cycle, str(port)))
    return found


def _wrong(
    recorded: DeviceRun,
    equality: Equality,
    port: Port[Message],
    cycle: int,
    mine: Answer | None,
    answers: Sequence[Answer],
) -> Iterator[tuple[str, str]]:
    """Yield requirement and text of what is wrong in the answers on a port in a cycle."""
    if not answers:
        if mine is not None and recorded.has_begun(cycle):
            yield "", "nothing came"
        return
    its, heard_ns = answers[0]
    if cycle >= recorded.cycles:
        yield "stop", "published after the end of the run"
        return
    if len(answers) > 1:
        yield "links", "it came twice"
    came_ns = its.publish_time_ns
    is_now = heard_ns - _OLDEST_NS < came_ns <= heard_ns + _CLOCKS_DIFFER_NS
    if came_ns and not (is_now and its.ready_time_ns <= came_ns):
        yield "head", "expected ready_time_ns and publish_time_ns of this clock, or 0"
    wrong = out_of_range(recorded.plan, port, its, heard_ns)
    if wrong and not wrong.startswith("sim_time_ns"):
        yield "bounds", wrong
    elif mine is None:
        yield "", "published, expected nothing"
    elif late_ms := recorded.late_ms(port, cycle, answers[0], mine):
        # It was decided later than ours, maybe on other inputs.
        yield "", f"answered {late_ms:.0f} ms late"
    else:
        ignored = frozenset() if its.missing else frozenset({"missing"})  # It may be left empty.
        for one in Equality(equality.tolerance, ignored).differences(port, its, mine.message)[:1]:
            requirement = "head" if one.field in _OF_THE_HEAD else ""
            yield requirement, f"{one.field}: expected {one.new}, got {one.recorded}"
