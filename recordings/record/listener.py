"""Writes down each message that the recorder hears, and tells the checks."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from math import inf
from typing import Final, NamedTuple

from msgspec.structs import replace

from agents.plan import RunPlan
from agents.process.events import Armed, Event, Remark, Status
from bus_schemas.bus import Cause
from bus_schemas.codec import UNREADABLE, decode_head, open_bundle
from bus_schemas.messages import Head, Message, Ready, Run
from bus_schemas.signals import DISPATCH, HELP, PRODUCTION, RUN, Port
from bus_schemas.tree import PLANT, RECORDER, ROOT
from recordings.record.complaints import Complaints, SecondSenders
from recordings.record.devices import DeviceWatch
from recordings.record.phases import ArmingRound, RunProgress
from recordings.record.plausibility import out_of_range
from recordings.record.reach import Reach
from recordings.record.writer import RunWriter

_FAR_AHEAD: Final = 1000
"""A message further ahead of the dispatch than this is refused [cycles]."""


_NAMED: Final = 3
"""How many of those that do not answer in arming rounds are named."""


class _Key(NamedTuple):
    """Facts on a key, worked out once.

    is_read: Whether its messages are decoded.
    is_elsewhere: Whether the launcher does not start its publisher.
    last_cycle: The last cycle that a message can be of; None: that depends on the run.
    """

    port: Port[Message]
    is_read: bool
    is_elsewhere: bool
    last_cycle: int | None


def _key(plan: RunPlan, port: Port[Message]) -> _Key:
    is_elsewhere = port.publisher in plan.elsewhere
    is_read = is_elsewhere or port.signal in {DISPATCH, HELP, PRODUCTION, RUN}
    last_cycle = None if port.publisher in plan.access.external else plan.timing.cycles
    return _Key(port, is_read, is_elsewhere, last_cycle)


class RunListener:
    """Hears the messages of a run.

    tell: Tells the launcher.
    joins_late: Whether the run may be under way: this recorder replaces another one.
    """

    def __init__(
        self,
        plan: RunPlan,
        writer: RunWriter,
        tell: Callable[[Event], None],
        now_ns: Callable[[], int],
        *,
        joins_late: bool = False,
    ) -> None:
        self.progress = RunProgress(plan)
        self.senders = SecondSenders(plan)
        self.complaints = Complaints(tell)
        self._plan = plan
        self._writer = writer
        self._heard_elsewhere = 0
        self._tell = tell
        self._now_ns = now_ns
        self._arming = ArmingRound(plan, answered=joins_late)
        self._reach = Reach(plan, now_ns())
        self._devices = DeviceWatch(plan)
        keys = {port: _key(plan, port) for port in plan.wiring.ports}
        self._keys = {plan.wiring.key(port): key for port, key in keys.items()}
        self._bundles = {
            plan.wiring.key(bundle): {text: keys[port] for text, port in bundle.ports.items()}
            for bundle in plan.wiring.bundles
        }

    @property
    def own_heard(self) -> int:
        """Number of messages of the launcher's processes."""
        return self._writer.heard - self._heard_elsewhere - self.senders.extra.total()

    def hear(self, key: str, payload: bytes) -> Ready | None:
        """Take in a message, or a bundle; return an answer if it completes an arming round."""
        known = self._keys.get(key)
        if known is None:
            return self._hear_bundle(key, payload)
        try:
            head = decode_head(payload)
        except UNREADABLE as error:
            self._complain(key, Cause.UNDECODABLE, str(error))
            return None
        return self._hear(key, known, head, payload)

    def _hear_bundle(self, key: str, payload: bytes) -> Ready | None:
        known = self._bundles.get(key)
        if known is None:
            self._complain(
                key, Cause.UNKNOWN, f"this run has no such node or signal{_sender(payload)}"
            )
            return None
        answer = None
        try:
            for of, head, part in open_bundle(payload):
                if (one := known.get(of)) is None:
                    self._complain(key, Cause.UNKNOWN, f"it holds a message of {of}")
                else:
                    answer = self._hear(of, one, head, part) or answer
        except UNREADABLE as error:
            self._complain(key, Cause.UNDECODABLE, str(error))
        return answer

    def _hear(self, key: str, known: _Key, head: Head, payload: bytes) -> Ready | None:
        port = known.port
        try:
            message = port.signal.decode(payload) if known.is_read else None
        except UNREADABLE as error:
            self._complain(key, Cause.UNDECODABLE, str(error))
            return None
        if head.source != port.publisher:
            self._complain(key, Cause.WRONG_SENDER, f"it is from {head.source!r}")
        elif head.cycle < 0:
            if not self._plan.timing.lockstep:
                self._reach.hear(port, head, payload, self._now_ns())
            if self._arming.hear(port, head.cycle):
                return Ready(head.cycle, head.sim_time_ns, RECORDER, ())
        elif port.signal.logged:
            last_cycle = known.last_cycle
            if head.cycle <= (self._last_cycle_of(port) if last_cycle is None else last_cycle):
                self._record(key, known, head, message, payload)
            else:
                self._complain(key, Cause.WRONG_CYCLE, f"it is of cycle {head.cycle}")
        return None

    def _complain(self, key: str, cause: str, text: str) -> None:
        self.complaints.add(key, cause, f"in cycle {self.progress.newest_cycle}, {text}")

    def status(self) -> Status:
        """Return where the run stands, and the agents that are unresponsive or not heard yet."""
        status = self.progress.status(self._writer.number_recorded)
        if self.progress.newest_cycle < 0:
            silent = self._arming.never_heard()
            status = replace(
                status,
                unheard=self._arming.unheard(self._plan.elsewhere),
                never_heard=(silent[:_NAMED], len(silent)),
            )
        if not self._plan.timing.lockstep:
            now_ns = self._now_ns()
            status = replace(
                status,
                not_recorded=self._reach.not_recorded(now_ns),
                not_heard=self._reach.not_heard(now_ns),
            )
        return status

    def _last_cycle_of(self, port: Port[Message]) -> float:
        """Return the last cycle of which an external agent can send a message now."""
        if port.publisher == PLANT:
            return inf
        if not self._arming.answered:
            return -1
        newest = self.progress.newest_cycle
        return inf if newest < 0 else newest + _FAR_AHEAD

    def _record(
        self, key: str, known: _Key, head: Head, message: Message | None, payload: bytes
    ) -> None:
        port, heard_ns = known.port, self._now_ns()
        self._writer.add(port, head, payload, heard_ns)
        if not self._plan.timing.lockstep:  # There each agent waits for its inputs.
            self._reach.hear(port, head, payload, heard_ns)
            for text in self._devices.hear(port, head, payload):
                self._tell(Remark(text))
        complaint = self.senders.hear(port, head.cycle, head.incarnation, payload)
        if known.is_elsewhere and message is not None:
            self._heard_elsewhere += 1
            if complaint is None and (text := out_of_range(self._plan, port, message, heard_ns)):
                complaint = Cause.OUT_OF_RANGE, text
        if complaint is not None:
            self._complain(key, *complaint)
        elif message is not None:
            self._follow(port, message, heard_ns)

    def _follow(self, port: Port[Message], message: Message, heard_ns: int) -> None:
        is_external = PLANT in self._plan.access.external
        if is_external and isinstance(message, Run) and message.state == "start":
            self._tell(Armed(message.start_time_ns))
        false_stop = self.progress.hear(port, message, heard_ns / 1e9)
        if false_stop is not None:
            begun = self.progress.newest_cycle
            text = f"it stops the run before cycle {false_stop}, and cycle {begun} has begun"
            self.complaints.add(self._plan.wiring.key(RUN.of(ROOT)), Cause.CONFLICTING, text)
            self.senders.note_extra(RUN.of(ROOT))


def _sender(payload: bytes) -> str:
    with suppress(*UNREADABLE):
        return f"; it is from {decode_head(payload).source!r}"
    return ""
