"""One run around a device: plays its inputs, and lets our own agent hear the same."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import count
from typing import Any, Final, Literal, NoReturn, TypeAlias

import msgspec

from agents.agent import Stage
from agents.loop import Loop
from agents.plan import RunPlan
from agents.team import controller
from bus_schemas.codec import decode, encode
from bus_schemas.errors import FailureError, listed
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import PLANT, ROOT
from sim_plant.plant_run import FIRST_ROUND
from studies.conformance.answers import Answers
from studies.conformance.device import Device
from studies.conformance.neighbours import Neighbours
from studies.conformance.requirements import Findings

_ROUND_S: Final = 1.0
_ARMING_S: Final = 10.0
_PATIENCE_S: Final = 5.0
_UNRESPONSIVE_CYCLES: Final = 5
"""After so many cycles without an answer a trial ends."""

_QUIET_S: Final = 0.3
"""How long nothing may come where nothing is expected, outside the cycles of real time."""

Edit: TypeAlias = Mapping[Port[Message], Sequence[bytes]]
"""What is sent in a cycle in place of the messages of some ports."""


class Trial:
    """One run around a device that replaces an agent.

    inputs: What our own agent hears in each cycle of an undisturbed run.
    requirement: What the answers from now on show.
    incarnations: Of the neighbours whose process is to be another than the first one.
    """

    def __init__(
        self,
        plan: RunPlan,
        agent: str,
        inputs: Mapping[int, Mapping[Port[Message], Message]],
        bus: Neighbours,
        findings: Findings,
        answers: Answers,
    ) -> None:
        self.plan = plan
        self.agent = agent
        self.requirement = "arming"
        self.cycle = 0
        self.incarnations: dict[str, int] = {}
        self._inputs = inputs
        self._bus = bus
        self._findings = findings
        self._answers = answers
        self._start_ns = 0
        self._begin_ours()

    def _begin_ours(self, cycle: int = 0) -> None:
        """Let our own agent join in a cycle of the run, or in an arming round."""
        self._ours: Loop[Any] = Loop(controller(self.plan, self.agent), self.plan)
        if cycle < 0:
            self._ours.enter(cycle, 0)
        else:
            self._ours.begin(0, 0, cycle)

    def show(self, requirement: str) -> None:
        """Let the answers from now on show a requirement."""
        self.requirement = requirement
        self._findings.try_(requirement)

    # The beginning and the end --------------------------------------------------------------------

    def begin(self, device: Device, wait_s: float) -> None:
        """Wait for the device, arm it, and start the run."""
        self._await(device, wait_s)
        self.show(self.requirement)
        give_up_at = time.monotonic() + _ARMING_S
        for number in count(FIRST_ROUND + 1):
            self._begin_ours(number)
            if not (unanswered := self._play(number, {})):
                break
            if time.monotonic() > give_up_at:
                self._give_up(f"in arming rounds nothing came on {listed(unanswered)}")
        self._begin_ours()
        self._findings.doubt = ""
        self._start_ns = time.monotonic_ns() + 200_000_000
        self._say("start")

    def stop(self) -> None:
        """Say that the run is over; nothing may come after that."""
        self._findings.try_("stop")
        # A device with a clock goes on to the next cycle by itself.
        quiet_s = min(_QUIET_S, 0.2 * self.plan.timing.cycle_wall_ns / 1e9 or _QUIET_S)
        while (heard := self._bus.next(quiet_s)) is not None:
            self._answers.take(heard)
        self._say("stop")
        while (heard := self._bus.next(_QUIET_S)) is not None:
            self._findings.fail("stop", f"{heard.key} was published after the run had stopped")

    def _say(self, state: Literal["start", "stop"]) -> None:
        """Say that the run begins, or that the next cycle does not take place."""
        run = self.plan.run_message(state, self.cycle, self._start_ns)
        self._bus.put(RUN.of(ROOT), encode(run))

    def _await(self, device: Device, wait_s: float) -> None:
        """Wait until each neighbour sees the device's token."""
        requirement, self.requirement = self.requirement, "token"
        self._findings.try_("token")
        give_up_at = time.monotonic() + wait_s
        while absent := self._bus.absent:
            if device.end_text:
                self._give_up(device.end_text)
            if time.monotonic() > give_up_at:
                self._give_up(f"{listed(absent)} saw no liveliness token in {wait_s:g} s")
            time.sleep(0.02)
        self.requirement = requirement

    def _give_up(self, text: str) -> NoReturn:
        self._findings.fail(self.requirement, text)
        raise FailureError(f"{self.agent}: {text}")

    # Cycles ---------------------------------------------------------------------------------------

    def skip(self) -> bool:
        """Play a cycle in which the device may be gone; return whether it answered anything.

        It is a new process then: so is our own agent. It hears nothing before all its links are
        open: what it decides would depend on their order.
        """
        self._answers.expect_new_process()
        cycle = self.cycle
        self._begin_ours(cycle)
        edit = dict.fromkeys(self.ports(), ()) if self._bus.absent else {}
        self._play(cycle, edit, is_judged=False)
        limit_ns = self._limit_ns(cycle)
        while (heard := self._bus.next((limit_ns - time.monotonic_ns()) / 1e9)) is not None:
            self._answers.take(heard)
        self.cycle += 1
        return self._answers.newest_cycle == cycle

    def play(self, edit: Edit | None = None, late: Edit | None = None) -> None:
        """Play the next cycle, and judge its answers.

        `edit` is sent in place of the undisturbed messages, `late` after the last answer.
        """
        cycle = self.cycle
        if self._play(cycle, edit or {}):
            is_expired = cycle - self._answers.newest_cycle >= _UNRESPONSIVE_CYCLES
            if self._bus.absent or is_expired:
                self._give_up(f"cycle {cycle}: it has gone, or is unresponsive")
        for port, payloads in (late or {}).items():
            self._send(port, payloads)
        self.cycle += 1

    def message(self, port: Port[Message], **changes: object) -> Message:
        """Return the undisturbed message of a port in the next cycle, with changes."""
        return self._retimed(self._inputs[self.cycle][port], self.cycle, changes)

    def ports(self, cycle: int | None = None) -> list[Port[Message]]:
        """Return the ports of which a message is due in a cycle, the next one by default."""
        return list(self._inputs[self.cycle if cycle is None else cycle])

    def _retimed(self, message: Message, cycle: int, changes: Mapping[str, object]) -> Message:
        now_ns = time.monotonic_ns()
        head: dict[str, Any] = {
            "cycle": cycle,
            "sim_time_ns": self.plan.timing.sim_time_ns(cycle),
            "sequence": max(cycle, 0),
            "incarnation": self.incarnations.get(message.source, 0) if cycle >= 0 else 0,
            "ready_time_ns": now_ns,
            "publish_time_ns": now_ns,
        }
        if self._in_real_time(cycle) and message.source == PLANT:
            head["ready_time_ns"] = self._begin_ns(cycle)
        return msgspec.structs.replace(message, **(head | dict(changes)))

    def _in_real_time(self, cycle: int) -> bool:
        return cycle >= 0 and self.plan.timing.cycle_wall_ns > 0

    def _begin_ns(self, cycle: int) -> int:
        return self._start_ns + cycle * self.plan.timing.cycle_wall_ns

    def _limit_ns(self, cycle: int) -> int:
        """Return up to when answers of a cycle are awaited."""
        if self._in_real_time(cycle):
            return self._begin_ns(cycle) + round(0.97 * self.plan.timing.cycle_wall_ns)
        return time.monotonic_ns() + round((_PATIENCE_S if cycle >= 0 else _ROUND_S) * 1e9)

    def _play(self, cycle: int, edit: Edit, *, is_judged: bool = True) -> list[str]:
        """Play a cycle stage by stage; return the keys on which no answer came in time.

        If nothing is judged the device need not be there.
        """
        if self._in_real_time(cycle):
            time.sleep(max(self._begin_ns(cycle) - time.monotonic_ns(), 0) / 1e9)
        inputs = self._inputs[max(cycle, 0)]
        limit_ns = self._limit_ns(cycle)
        expected: dict[Port[Message], Message] = {}
        sent: set[Port[Message]] = set()
        stages = self._ours.agent.stages(cycle)
        unanswered: list[str] = []
        for stage, (by_ns, until_ns) in zip(stages, self._times_ns(stages, cycle), strict=True):
            for port in (*stage.awaits, *stage.uses):
                if port in inputs and port not in sent:
                    sent.add(port)
                    whole = (encode(self._retimed(inputs[port], cycle, {})),)
                    self._send(port, edit.get(port, whole))
            is_late = self._in_real_time(cycle) and time.monotonic_ns() > by_ns
            if is_judged and is_late and not self._findings.doubt:
                self._findings.doubt = (
                    f"from cycle {cycle} on the machine was too slow to judge: inputs of the stage "
                    f"{stage.name} went out too late; try a lower --pace"
                )
            least_ns = until_ns if self._ours.waiting else 0
            due = dict(self._ours.close_stage(0))
            expected |= due
            latest_ns = limit_ns if stage is stages[-1] else until_ns
            unanswered += self._collect(due, cycle, latest_ns, least_ns)
        # A device without a clock publishes nothing in a cycle of whose beginning it hears nothing.
        heard_nothing = not any(edit.get(port, True) for port in stages[0].awaits)
        if is_judged and not (unanswered and (heard_nothing or cycle < 0)):
            self._answers.compare(expected, cycle, self.requirement)
        return unanswered

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
            self._bus.put(port, payload)
            with suppress(msgspec.DecodeError):
                self._ours.hear(port, decode(port.signal, payload), 0)

    def _collect(
        self, ports: Iterable[Port[Message]], cycle: int, limit_ns: int, least_ns: int
    ) -> list[str]:
        """Take in what comes until all listeners have what they should, or it is too late.

        If the device waits for its deadline, it may send what nobody awaits up to `least_ns`.
        Returns the keys on which nothing came.
        """
        while (due := self._answers.still_due(ports, cycle)) or time.monotonic_ns() < least_ns:
            until_ns = limit_ns if due else least_ns
            heard = self._bus.next((until_ns - time.monotonic_ns()) / 1e9)
            if heard is None:
                return sorted({str(port) for _, port, _ in due})
            self._answers.take(heard)
        return []
