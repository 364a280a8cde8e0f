"""What a device publishes in a trial: checked as it comes, and compared with our own agent's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

import msgspec

from agents.plan import RunPlan
from bus_schemas.codec import decode
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import RECORDER
from recordings.record.plausibility import out_of_range
from recordings.verify.equality import Equality
from studies.conformance.neighbours import Heard
from studies.conformance.requirements import Findings


class Answers:
    """The messages of a device, by port and cycle. `equality` says what counts as equal."""

    def __init__(self, plan: RunPlan, agent: str, findings: Findings, equality: Equality) -> None:
        self._plan = plan
        self._agent = agent
        self._findings = findings
        self._equality = equality
        self._cyclic = [port for port in plan.wiring.published[agent] if port.signal.is_cyclic]
        self._messages: dict[tuple[Port[Message], int], Message] = {}
        self._arrived: Counter[tuple[str, Port[Message], int]] = Counter()
        self._sequence: Counter[Port[Message]] = Counter()
        self._incarnation: int | None = 0

    @property
    def newest_cycle(self) -> int:
        """The newest cycle that it has answered; -1: none of the run."""
        return max((cycle for _, cycle in self._messages), default=-1)

    def expect_new_process(self) -> None:
        """Let the device be a new process from now on: it joins with its first message."""
        self._incarnation = None
        self._sequence.clear()

    def still_due(
        self, ports: Iterable[Port[Message]], cycle: int
    ) -> set[tuple[str, Port[Message], int]]:
        """Return what has not come of a cycle: listener, port and cycle of each message."""
        due = {
            (listener, port, cycle)
            for port in ports
            if port in self._cyclic
            for listener in (RECORDER, *self._plan.wiring.listeners[port])
        }
        return {one for one in due if not self._arrived[one]}

    def take(self, heard: Heard) -> None:
        """Take in one payload, and check all that needs no comparison."""
        fail, is_recorder = self._findings.fail, heard.listener == RECORDER
        port = self._plan.wiring.port(heard.key)
        if port is None or port.publisher != self._agent:
            fail("decisions", f"{heard.key} was published, a key of another or of nobody")
            return
        try:
            message = decode(port.signal, heard.payload)
        except msgspec.DecodeError as error:
            fail("bounds", f"{port}: {error}")
            return
        where = f"cycle {message.cycle}, {port}"
        arrival = (heard.listener, port, message.cycle)
        self._arrived[arrival] += 1
        if self._arrived[arrival] > 1 and port.signal.is_cyclic:
            fail("links", f"{where}: it came twice to {heard.listener}")
        elif is_recorder:
            self._messages[port, message.cycle] = message
            for text in self._wrong_in_head(port, message, heard.time_ns):
                fail("head", f"{where}: {text}")
            self._findings.try_("bounds")
            text = out_of_range(self._plan, port, message, heard.time_ns)
            if text and not text.startswith("sim_time_ns"):
                fail("bounds", f"{where}: {text}")

    def _wrong_in_head(self, port: Port[Message], message: Message, heard_ns: int) -> Iterator[str]:
        self._findings.try_("head")
        sequence = 0
        if message.cycle >= 0:
            sequence = self._sequence[port]
            self._sequence[port] = message.sequence + 1
            if self._incarnation is None:
                self._incarnation = message.cycle
        right = {
            "source": self._agent,
            "sim_time_ns": self._plan.timing.sim_time_ns(message.cycle),
            "sequence": sequence,
            "incarnation": self._incarnation if message.cycle >= 0 else 0,
        }
        for field, value in right.items():
            if getattr(message, field) != value:
                yield f"{field}: expected {value}, got {getattr(message, field)}"
        ready_ns, published_ns = message.ready_time_ns, message.publish_time_ns
        if published_ns and not heard_ns - 10_000_000_000 < published_ns <= heard_ns + 50_000_000:
            yield "publish_time_ns: expected the time of this host's monotonic clock, or 0"
        if ready_ns and published_ns and ready_ns > published_ns:
            yield "ready_time_ns: expected a time before publish_time_ns"

    def compare(self, own: Mapping[Port[Message], Message], cycle: int, requirement: str) -> None:
        """Compare the answers of a cycle with our own agent's."""
        self._findings.try_("links")
        for port in self._cyclic:
            ours, its = own.get(port), self._messages.get((port, cycle))
            where = f"cycle {cycle}, {port}"
            if ours is not None and its is not None:
                self._compare_one(port, ours, its, requirement)
            elif its is not None:
                self._findings.fail(requirement, f"{where}: published, expected nothing")
            elif ours is not None:
                self._findings.fail(requirement, f"{where}: nothing came")

    def _compare_one(self, port: Port[Message], ours: Message, its: Message, of: str) -> None:
        for listener in self._plan.wiring.listeners[port]:
            if not self._arrived[listener, port, its.cycle]:
                text = f"cycle {its.cycle}, {port}: not heard by {listener}"
                self._findings.fail("links", text)
        ignored = {"source", "sim_time_ns", "incarnation"}  # They are part of the head.
        if not its.missing:  # A device may leave it empty.
            ignored.add("missing")
        equality = Equality(self._equality.tolerance, frozenset(ignored))
        for difference in equality.differences(port, its, ours):
            text = f"{difference.field}: expected {difference.new}, got {difference.recorded}"
            self._findings.fail(of, f"cycle {its.cycle}, {port}, {text}")
            return
