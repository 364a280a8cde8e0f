"""One run around a device: plays its inputs, and compares its answers with our own agent's."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from typing import Any, Final, Literal, NoReturn, TypeAlias

import msgspec

from agents.agent import Stage
from agents.loop import AgentLoop
from agents.plan import RunPlan
from agents.team import controller
from bus_schemas.codec import decode, encode
from bus_schemas.errors import FailureError
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import PLANT, RECORDER, ROOT, some_of
from recordings.record.plausibility import absurdity
from recordings.verify.comparison import Comparison
from sim_plant.plant_run import FIRST_ROUND
from studies.conformance.device import Device
from studies.conformance.neighbours import Heard, Neighbours
from studies.conformance.requirements import Findings

_ROUND_S: Final = 1.0
_ARMING_S: Final = 10.0
_PATIENCE_S: Final = 5.0
_SILENT_CYCLES: Final = 5
"""After so many cycles without a word a trial ends."""

_QUIET_S: Final = 0.3
"""How long nothing may come where nothing is expected, outside the cycles of real time."""

Edit: TypeAlias = Mapping[Port[Message], Sequence[bytes]]
"""What is sent in a cycle in place of the messages of some ports."""


@dataclass(eq=False)
class Trial:
    """One run around a device that is in an agent's place.

    `inputs` is what our own agent hears in each cycle of an undisturbed run; `comparison` says what
    counts as equal.
    """

    plan: RunPlan
    agent: str
    inputs: Mapping[int, Mapping[Port[Message], Message]]
    bus: Neighbours
    findings: Findings
    comparison: Comparison

    def __post_init__(self) -> None:
        self.cycle = 0
        self.start_ns = 0
        self.incarnations: dict[str, int] = {}
        published = self.plan.wiring.published[self.agent]
        self._published = [port for port in published if port.signal.is_cyclic]
        self._outputs: dict[tuple[Port[Message], int], Message] = {}
        self._arrived: Counter[tuple[str, Port[Message], int]] = Counter()
        self._sequence: Counter[Port[Message]] = Counter()
        self._incarnation: int | None = 0
        self._unanswered: list[str] = []
        self._begin_ours()

    def _begin_ours(self, cycle: int = 0) -> None:
        """Let our own agent join in a cycle of the run, or in an arming round."""
        self._ours: AgentLoop[Any] = AgentLoop(controller(self.plan, self.agent), self.plan)
        if cycle < 0:
            self._ours.enter(cycle, 0)
        else:
            self._ours.begin(0, 0, cycle)

    # The beginning and the end --------------------------------------------------------------------

    def begin(self, device: Device, wait_s: float, of: str) -> None:
        """Wait for the device, arm it, and start the run; `of` is the requirement that it shows."""
        self._await(device, wait_s)
        self.findings.try_(of)
        give_up_at = time.monotonic() + _ARMING_S
        for number in count(FIRST_ROUND + 1):
            self._begin_ours(number)
            if self._play(number, {}, of):
                break
            if time.monotonic() > give_up_at:
                self._give_up(of, f"in arming rounds nothing came on {some_of(self._unanswered)}")
        self._begin_ours()
        self.findings.doubt = ""
        self.start_ns = time.monotonic_ns() + 200_000_000
        self._say("start")

    def stop(self) -> None:
        """Say that the run is over; nothing may come after that."""
        self.findings.try_("stop")
        # A device with a clock goes on to the next cycle by itself.
        quiet_s = min(_QUIET_S, 0.2 * self.plan.cycle_wall_ns / 1e9 or _QUIET_S)
        while (heard := self.bus.next(quiet_s)) is not None:
            self._take(heard)
        self._say("stop")
        while (heard := self.bus.next(_QUIET_S)) is not None:
            self.findings.fail("stop", f"{heard.key} was published after the run had stopped")

    def _say(self, state: Literal["start", "stop"]) -> None:
        """Say that the run begins, or that the next cycle does not take place."""
        run = self.plan.run_message(state, self.cycle, self.start_ns)
        self.bus.put(RUN.of(ROOT), encode(run))

    def _await(self, device: Device, wait_s: float) -> None:
        """Wait until each neighbour sees the device's token."""
        self.findings.try_("token")
        give_up_at = time.monotonic() + wait_s
        while absent := self.bus.absent:
            if device.end_text:
                self._give_up("token", device.end_text)
            if time.monotonic() > give_up_at:
                self._give_up("token", f"{some_of(absent)} saw no liveliness token in {wait_s:g} s")
            time.sleep(0.02)

    def _give_up(self, requirement: str, text: str) -> NoReturn:
        self.findings.fail(requirement, text)
        raise FailureError(f"{self.agent}: {text}")

    # Cycles ---------------------------------------------------------------------------------------

    def skip(self) -> bool:
        """Play a cycle in which the device may be gone; return whether it answered anything.

        It is a new process then: so is our own agent. It hears nothing before all its links are
        open: what it decides would depend on their order.
        """
        self._incarnation = None
        self._sequence.clear()
        cycle = self.cycle
        self._begin_ours(cycle)
        self._play(cycle, dict.fromkeys(self.ports(), ()) if self.bus.absent else {}, None)
        limit_ns = self._limit_ns(cycle)
        while (heard := self.bus.next((limit_ns - time.monotonic_ns()) / 1e9)) is not None:
            self._take(heard)
        self.cycle += 1
        return any(place[1] == cycle for place in self._outputs)

    def play(self, requirement: str, edit: Edit | None = None, late: Edit | None = None) -> None:
        """Play the next cycle; its answers show a requirement.

        `edit` is sent in place of the undisturbed messages, `late` after the last answer.
        """
        cycle = self.cycle
        self.findings.try_(requirement)
        if not self._play(cycle, edit or {}, requirement):
            last = max((of for _, of in self._outputs), default=-1)
            if self.bus.absent or cycle - last >= _SILENT_CYCLES:
                self._give_up(requirement, f"cycle {cycle}: it has gone, or is silent")
        for port, payloads in (late or {}).items():
            self._send(port, payloads)
        self.cycle += 1

    def message(self, port: Port[Message], **changes: object) -> Message:
        """Return the undisturbed message of a port in the next cycle, with changes."""
        return self._retimed(self.inputs[self.cycle][port], self.cycle, changes)

    def ports(self, cycle: int | None = None) -> list[Port[Message]]:
        """Return the ports of which a message is due in a cycle, the next one by default."""
        return list(self.inputs[self.cycle if cycle is None else cycle])

    def _retimed(self, message: Message, cycle: int, changes: Mapping[str, object]) -> Message:
        now_ns = time.monotonic_ns()
        head: dict[str, Any] = {
            "cycle": cycle,
            "sim_time_ns": self.plan.sim_time_ns(cycle),
            "sequence": max(cycle, 0),
            "incarnation": self.incarnations.get(message.source, 0) if cycle >= 0 else 0,
            "ready_time_ns": now_ns,
            "publish_time_ns": now_ns,
        }
        if self._in_real_time(cycle) and message.source == PLANT:
            head["ready_time_ns"] = self._begin_ns(cycle)
        return msgspec.structs.replace(message, **(head | dict(changes)))

    def _in_real_time(self, cycle: int) -> bool:
        return cycle >= 0 and self.plan.cycle_wall_ns > 0

    def _begin_ns(self, cycle: int) -> int:
        return self.start_ns + cycle * self.plan.cycle_wall_ns

    def _limit_ns(self, cycle: int) -> int:
        """Return up to when answers of a cycle are awaited."""
        if self._in_real_time(cycle):
            return self._begin_ns(cycle) + round(0.97 * self.plan.cycle_wall_ns)
        return time.monotonic_ns() + round((_PATIENCE_S if cycle >= 0 else _ROUND_S) * 1e9)

    def _play(self, cycle: int, edit: Edit, requirement: str | None) -> bool:
        """Play a cycle stage by stage; return whether all answers came in time.

        Without a requirement the device need not be there, and nothing is judged.
        """
        if self._in_real_time(cycle):
            time.sleep(max(self._begin_ns(cycle) - time.monotonic_ns(), 0) / 1e9)
        inputs = self.inputs[max(cycle, 0)]
        limit_ns = self._limit_ns(cycle)
        expected: dict[Port[Message], Message] = {}
        sent: set[Port[Message]] = set()
        stages = self._ours.agent.stages(cycle)
        self._unanswered = []
        for stage, (by_ns, until_ns) in zip(stages, self._times_ns(stages, cycle), strict=True):
            for port in (*stage.awaits, *stage.uses):
                if port in inputs and port not in sent:
                    sent.add(port)
                    whole = (encode(self._retimed(inputs[port], cycle, {})),)
                    self._send(port, edit.get(port, whole))
            is_late = self._in_real_time(cycle) and time.monotonic_ns() > by_ns
            if requirement and is_late and not self.findings.doubt:
                self.findings.doubt = (
                    f"from cycle {cycle} on the machine was too slow to judge: inputs of the stage "
                    f"{stage.name} went out too late; try a lower --pace"
                )
            least_ns = until_ns if self._ours.waiting else 0
            due = dict(self._ours.close_stage(0))
            expected |= due
            wanted = [port for port in due if port in self._published]
            self._collect(wanted, cycle, limit_ns if stage is stages[-1] else until_ns, least_ns)
        # A device without a clock is silent in a cycle of whose beginning it hears nothing.
        heard_nothing = not any(edit.get(port, True) for port in stages[0].awaits)
        if requirement and not (self._unanswered and (heard_nothing or cycle < 0)):
            self._judge(expected, cycle, requirement)
        return not self._unanswered

    def _times_ns(self, stages: Sequence[Stage], cycle: int) -> list[tuple[int, int]]:
        """Return by when the inputs of each stage go out, and up to when they may still come.

        What comes between that and the next stage does not depend on the device's answers.
        """
        limit_ns = self._limit_ns(cycle)
        if not self._in_real_time(cycle):
            return [(limit_ns, limit_ns)] * len(stages)
        from_ns = self._begin_ns(cycle)
        close = [from_ns + self.plan.deadlines.deadline_ns(self.agent, one.name) for one in stages]
        times = []
        for close_ns, next_ns in zip(close, [*close[1:], limit_ns], strict=True):
            until_ns = (close_ns + next_ns) // 2
            times.append(((from_ns + close_ns) // 2, until_ns))
            from_ns = until_ns
        return times

    def _send(self, port: Port[Message], payloads: Iterable[bytes]) -> None:
        for payload in payloads:
            self.bus.put(port, payload)
            with suppress(msgspec.DecodeError):
                self._ours.hear(port, decode(port.signal, payload), 0)

    def _collect(
        self, wanted: Sequence[Port[Message]], cycle: int, limit_ns: int, least_ns: int
    ) -> None:
        """Take in what comes until all listeners have what they should, or it is too late.

        If the device waits for its deadline, it may send what nobody wants up to `least_ns`.
        """
        due = {
            (listener, port, cycle)
            for port in wanted
            for listener in (RECORDER, *self.plan.wiring.listeners[port])
        }
        while (
            due := {place for place in due if not self._arrived[place]}
        ) or time.monotonic_ns() < least_ns:
            until_ns = limit_ns if due else least_ns
            heard = self.bus.next((until_ns - time.monotonic_ns()) / 1e9)
            if heard is None:
                self._unanswered += sorted({str(port) for _, port, _ in due})
                return
            self._take(heard)

    # What the device says -------------------------------------------------------------------------

    def _take(self, heard: Heard) -> None:
        """Take in one payload of the device's, and look at all that needs no comparison."""
        fail, is_recorder = self.findings.fail, heard.listener == RECORDER
        port = self.plan.wiring.port(heard.key)
        if port is None or port.publisher != self.agent:
            fail("decisions", f"{heard.key} was published, a key of another or of nobody")
            return
        try:
            message = decode(port.signal, heard.payload)
        except msgspec.DecodeError as error:
            fail("bounds", f"{port}: {error}")
            return
        where = f"cycle {message.cycle}, {port}"
        place = (heard.listener, port, message.cycle)
        self._arrived[place] += 1
        if self._arrived[place] > 1 and port.signal.is_cyclic:
            fail("links", f"{where}: it came twice to {heard.listener}")
        elif is_recorder:
            self._outputs[port, message.cycle] = message
            for text in self._wrong_in_head(port, message, heard.time_ns):
                fail("head", f"{where}: {text}")
            self.findings.try_("bounds")
            text = absurdity(self.plan, port, message, heard.time_ns)
            if text and not text.startswith("sim_time_ns"):
                fail("bounds", f"{where}: {text}")

    def _wrong_in_head(self, port: Port[Message], message: Message, heard_ns: int) -> Iterator[str]:
        self.findings.try_("head")
        sequence = 0
        if message.cycle >= 0:
            sequence = self._sequence[port]
            self._sequence[port] = message.sequence + 1
            if self._incarnation is None:  # It joins with its first message.
                self._incarnation = message.cycle
        right = {
            "source": self.agent,
            "sim_time_ns": self.plan.sim_time_ns(message.cycle),
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

    def _judge(self, expected: Mapping[Port[Message], Message], cycle: int, of: str) -> None:
        """Compare the answers of a cycle with our own agent's."""
        self.findings.try_("links")
        for port in self._published:
            own, its = expected.get(port), self._outputs.get((port, cycle))
            where = f"cycle {cycle}, {port}"
            if own is not None and its is not None:
                self._compare(port, own, its, of)
            elif its is not None:
                self.findings.fail(of, f"{where}: published, expected nothing")
            elif own is not None:
                self.findings.fail(of, f"{where}: nothing came")

    def _compare(self, port: Port[Message], own: Message, its: Message, of: str) -> None:
        for listener in self.plan.wiring.listeners[port]:
            if not self._arrived[listener, port, its.cycle]:
                self.findings.fail("links", f"cycle {its.cycle}, {port}: not heard by {listener}")
        ignored = {"source", "sim_time_ns", "incarnation"}
        if not its.missing:
            ignored.add("missing")
        comparison = Comparison(self.comparison.tolerance, frozenset(ignored))
        for found in comparison.differences(port, its, own):
            text = f"{found.field}: expected {found.new}, got {found.recorded}"
            self.findings.fail(of, f"cycle {its.cycle}, {port}, {text}")
            return
