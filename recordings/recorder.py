"""The recorder: hears everything on the bus of a run and writes it down. A process of its own.

A full disk ends the recording, not the run: the recorder then goes on to hear, since publishers in
lockstep wait for a listener who falls behind, and to say where the run stands.

It also knows best where the run stands, since it sees all of it, and tells the launcher; and in
the arming rounds it tells the plant that its ears are open.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Final

import msgspec

from agents.lifeline import Lifeline, Recorded, RecordingEnded
from agents.plan import RunPlan
from bus_schemas.codec import decode
from bus_schemas.messages import Message, Ready, Run
from bus_schemas.signals import DISPATCH, READY, Occurrence, Port, ports
from bus_schemas.tree import RECORDER, ROOT
from bus_schemas.zenoh_bus import ZenohTap
from recordings.lasting_writer import LastingWriter
from recordings.monitor import RunMonitor
from recordings.writer import RunWriter

log = logging.getLogger(__name__)

FLUSH_S: Final = 0.5
"""Time between flushes: as much as a crash can lose."""

_NAP_S: Final = 0.005
_STATUS_S: Final = 0.25
_MOST_AT_ONCE: Final = 2000
_CYCLE_WINDOW: Final = 1000
"""How many cycles ahead of the plant's last word a message can be on another link, generously."""

_QUIET_S: Final = 2.0
"""How long nothing must have come before the recorder stops waiting for what it was told of."""


class RecordingEnd:
    """Whether the recording has been asked to end, by any thread or signal.

    Attributes
    ----------
    expected
        Messages that must be in the file first; None: whatever still comes.
    """

    def __init__(self) -> None:
        self.expected: int | None = None
        self._asked = threading.Event()

    def __bool__(self) -> bool:
        return self._asked.is_set()

    def ask(self) -> None:
        """Let the recording end once nothing comes any more."""
        self._asked.set()

    def hear(self, word: str) -> None:
        """Take in the launcher's word: `expect N` messages."""
        self.expected = int(word.removeprefix("expect "))
        self._asked.set()


class Recorder:
    """Writes down a run.

    Parameters
    ----------
    plan
        Of the run.
    tap
        The recorder's place on the bus.
    writer
        The file.
    lifeline
        The line to the launcher.
    end
        Asked from outside.
    drop_log
        Called with a line of text for each payload that is no message of the run.
    attached
        Whether a launcher says when to end. Otherwise the run's own stop does.
    """

    def __init__(
        self,
        plan: RunPlan,
        tap: ZenohTap,
        writer: RunWriter,
        lifeline: Lifeline,
        end: RecordingEnd,
        drop_log: Callable[[str], None],
        attached: bool,
    ) -> None:
        self.monitor = RunMonitor()
        self.foreign = 0
        self.gaps: Counter[str] = Counter()
        self._plan = plan
        self._tap = tap
        self._writer = LastingWriter(writer, self._tell_end)
        self._lifeline = lifeline
        self._end = end
        self._drop_log = drop_log
        self._attached = attached
        self._newest_cycle = 0
        self._next_sequence: dict[Port[Message], int] = {}
        self._ready_port = READY.of(ROOT)
        self._round = Round(plan)

    def run(self) -> None:
        """Record until told to end, then close the file and report."""
        flush_at = status_at = heard_at = time.monotonic()
        while not self._may_end(time.monotonic() - heard_at):
            heard = self._drain()
            now = time.monotonic()
            if heard:
                heard_at = now
            else:
                time.sleep(_NAP_S)
            if now >= flush_at:
                self._writer.flush()
                flush_at = now + FLUSH_S
            if now >= status_at:
                self._tell_status()
                status_at = now + _STATUS_S
        self._writer.close()
        self._report()

    def _may_end(self, quiet_s: float) -> bool:
        if not self._end:
            return False
        expected = self._end.expected
        if expected is not None and self._writer.heard >= expected:
            return True
        return quiet_s > (_QUIET_S if expected is not None else FLUSH_S)

    def _drain(self) -> int:
        heard = 0
        for key, payload in self._tap.drain():
            self._hear(key, payload)
            heard += 1
            if heard == _MOST_AT_ONCE:
                break  # Flush and status must have their turn, however much comes.
        return heard

    def _hear(self, key: str, payload: bytes) -> None:
        port = self._plan.keys.port(key)
        message = self._understand(port, key, payload)
        if port is None or message is None:
            return
        if message.cycle < 0:
            if self._round.sees(port, message.cycle):
                self._answer_round(message)
        elif port.signal.logged:
            if port.signal is DISPATCH:
                self._newest_cycle = message.cycle
            if isinstance(message, Run) and message.state == "stop" and not self._attached:
                self._end.ask()
            self._count_gap(port, message)
            self._writer.add(port, message, payload, time.monotonic_ns())
            self.monitor.see(port, message)

    def _understand(self, port: Port[Message] | None, key: str, payload: bytes) -> Message | None:
        try:
            if port is None:
                raise ValueError("a node or signal that this run does not have")
            message = decode(port.signal, payload)
            if message.source != port.publisher:
                raise ValueError(f"it is from {message.source!r}")
            if message.cycle > self._newest_cycle + _CYCLE_WINDOW:
                raise ValueError(f"it is of cycle {message.cycle}, this is {self._newest_cycle}")
        except (ValueError, msgspec.DecodeError) as error:
            self.foreign += 1
            self._drop_log(f"{key}: {error}")
            return None
        return message

    def _count_gap(self, port: Port[Message], message: Message) -> None:
        expected = self._next_sequence.get(port, 0)
        if message.sequence > expected:
            self.gaps[port.signal.name] += message.sequence - expected
        self._next_sequence[port] = message.sequence + 1

    def _answer_round(self, message: Message) -> None:
        ready = Ready(message.cycle, message.sim_time_ns, RECORDER, ())
        self._tap.publish(self._ready_port, ready)

    def _tell_end(self, text: str) -> None:
        log.error("%s", text)
        self._lifeline.tell(RecordingEnded(text))

    def _tell_status(self) -> None:
        self._lifeline.tell(self.monitor.status(self._writer.recorded.total()))

    def _report(self) -> None:
        self._lifeline.tell(
            Recorded(
                recorded=dict(self._writer.recorded),
                gaps=dict(self.gaps),
                foreign=self.foreign,
                plant=self.monitor.plant,
                ended_early=self._writer.trouble,
            )
        )


class Round:
    """The arming round under way: which of the messages that always come have been heard."""

    def __init__(self, plan: RunPlan) -> None:
        steady = {Occurrence.CYCLE, Occurrence.TURN}
        self._all = frozenset(port for port in ports(plan.tree) if port.signal.occurrence in steady)
        self._cycle: int | None = None
        self._open: set[Port[Message]] = set()

    def sees(self, port: Port[Message], cycle: int) -> bool:
        """Take in a message of a round; return whether it was the last one that was missing."""
        if self._cycle is None or cycle > self._cycle:
            self._cycle, self._open = cycle, set(self._all)
        if cycle != self._cycle or port not in self._open:
            return False
        self._open.discard(port)
        return not self._open
