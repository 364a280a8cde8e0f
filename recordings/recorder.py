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
from collections.abc import Callable, Collection
from typing import Final

import msgspec
from msgspec.structs import replace

from agents.events import Armed, Over, Presence, Recorded, RecordingEnded
from agents.lifeline import Lifeline
from agents.plan import RunPlan
from bus_schemas.codec import decode
from bus_schemas.messages import Message, Ready, Run
from bus_schemas.signals import DISPATCH, READY, Occurrence, Port, ports
from bus_schemas.tree import PLANT, RECORDER, ROOT
from bus_schemas.zenoh_bus import ZenohTap
from recordings.external_agents import ExternalAgents
from recordings.lasting_writer import LastingWriter
from recordings.message_complaints import ABSURD, Complaints
from recordings.monitor import RunMonitor
from recordings.plausibility import absurdities
from recordings.recordable_messages import FAR_OFF, REPEATED, Objection, SpokenWords
from recordings.writer import RunWriter

log = logging.getLogger(__name__)

FLUSH_S: Final = 0.5
"""Time between flushes: as much as a crash can lose."""

_NAP_S: Final = 0.005
_STATUS_S: Final = 0.25
_MOST_AT_ONCE: Final = 2000
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
        self.complaints = Complaints(drop_log, lifeline.tell)
        self._plan = plan
        self._tap = tap
        self._writer = LastingWriter(writer, self._tell_end)
        self._lifeline = lifeline
        self._end = end
        self._attached = attached
        self._external = ExternalAgents(plan)
        self._newest_cycle = -1
        self._has_begun = False
        self._stop_cycle: int | None = None
        self._spoken = SpokenWords(plan)
        self._ready_port = READY.of(ROOT)
        self._round = Round(plan)

    def run(self) -> None:
        """Record until told to end, then close the file and report."""
        if self._plan.external:
            self._tap.watch_presence()
        flush_at = status_at = heard_at = time.monotonic()
        while not self._may_end(time.monotonic() - heard_at):
            heard = self._drain()
            self._tell_presence()
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
        if expected is not None and self._writer.heard - self._external.heard >= expected:
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
        if port is None:
            self.complaints.add(key, "unknown", "this run has no such node or signal")
            return
        try:
            message = decode(port.signal, payload)
        except msgspec.DecodeError as error:
            self.complaints.add(key, "undecodable", str(error))
            return
        objection = self._objection(port, message)
        if objection is not None:
            self.complaints.add(key, objection.cause, objection.text)
            if not objection.is_recorded:
                return
        if message.cycle < 0:
            if self._round.sees(port, message.cycle):
                self._answer_round(message)
        elif port.signal.logged:
            self._record(port, message, payload, is_first=objection is None)

    def _objection(self, port: Port[Message], message: Message) -> Objection | None:
        """Say what is wrong with a message, None if nothing."""
        cycle, publisher = message.cycle, port.publisher
        if message.source != publisher:
            return Objection("foreign", f"it is from {message.source!r}")
        if cycle < 0:
            return None
        if publisher in self._plan.external and publisher != PLANT and not self._round.answered:
            return Objection("other_cycle", f"it is of cycle {cycle}, before the run")
        if isinstance(message, Run) and message.state == "start":
            if self._has_begun:
                return Objection(REPEATED, "the run begins a second time", is_recorded=True)
            self._has_begun = True
        objection = self._spoken.objection(port, message, self._newest_cycle)
        is_far_off = objection is not None and objection.cause in FAR_OFF
        self._external.hear(port, message, is_far_off=is_far_off)
        return objection

    def _record(
        self, port: Port[Message], message: Message, payload: bytes, *, is_first: bool
    ) -> None:
        """Write down a message of the run, and follow the run by the first one of each cycle."""
        if port.signal is DISPATCH:
            self._newest_cycle = max(message.cycle, self._newest_cycle)
        elif isinstance(message, Run) and is_first:
            self._follow(message)
        heard_ns = time.monotonic_ns()
        self._external.record(port, is_answer=is_first)
        self._writer.add(port, message, payload, heard_ns)
        if not is_first:
            return
        if port.publisher in self._plan.external:
            absurd = absurdities(self._plan, port, message, heard_ns)
            if absurd:
                self.complaints.add(self._plan.keys.key(port), ABSURD, absurd)
                return
        self.monitor.see(port, message)

    def _follow(self, message: Run) -> None:
        """Take in the plant's word. What an external one says, the launcher hears from here."""
        if message.state == "stop":
            self._stop_cycle = message.cycle
            if not self._attached:
                self._end.ask()
        if PLANT in self._plan.external:
            began = message.state == "start"
            self._lifeline.tell(Armed(self._round.count) if began else Over(message.cycle))

    def _answer_round(self, message: Message) -> None:
        ready = Ready(message.cycle, message.sim_time_ns, RECORDER, ())
        self._tap.publish(self._ready_port, ready)

    def _tell_end(self, text: str) -> None:
        log.error("%s", text)
        self._lifeline.tell(RecordingEnded(text))

    def _tell_presence(self) -> None:
        """Say which external agents have come or gone. At the run's end all of them go."""
        for key, alive in self._tap.presence():
            agent = self._external.named(key)
            if agent is not None and self._stop_cycle is None:
                self._lifeline.tell(Presence(agent, alive, self._newest_cycle))

    def _tell_status(self) -> None:
        status = self.monitor.status(self._writer.recorded.total())
        if self._plan.external and self._newest_cycle < 0:
            status = replace(status, unheard=self._round.unheard(self._plan.external))
        self._lifeline.tell(status)

    def _report(self) -> None:
        cycles = self._newest_cycle + 1 if self._stop_cycle is None else self._stop_cycle
        self._lifeline.tell(
            Recorded(
                recorded=dict(self._writer.recorded),
                foreign=self.complaints.set_aside,
                plant=self.monitor.plant,
                ended_early=self._writer.trouble,
                external=self._external.accounts(cycles),
                complaints=self.complaints.all(),
            )
        )


class Round:
    """The arming round under way: which of the messages that always come have been heard.

    Attributes
    ----------
    count
        How many rounds have begun.
    answered
        Whether all of a round has been heard.
    """

    def __init__(self, plan: RunPlan) -> None:
        steady = {Occurrence.CYCLE, Occurrence.TURN}
        self._all = frozenset(port for port in ports(plan.tree) if port.signal.occurrence in steady)
        self.count = 0
        self.answered = False
        self._cycle: int | None = None
        self._open: set[Port[Message]] = set()
        self._last: dict[Port[Message], int] = {}

    def sees(self, port: Port[Message], cycle: int) -> bool:
        """Take in a message of a round; return whether it was the last one that was missing.

        Only the plant begins a round: what another one says of a later round is remembered, in case
        it has overtaken the plant's words.
        """
        if port.publisher == PLANT and (self._cycle is None or cycle > self._cycle):
            self._cycle = cycle
            self._open = {port for port in self._all if self._last.get(port) != cycle}
            self.count += 1
        self._last[port] = cycle
        if cycle != self._cycle or port not in self._open:
            return False
        self._open.discard(port)
        self.answered = self.answered or not self._open
        return not self._open

    def unheard(self, agents: Collection[str]) -> list[str]:
        """Keys, without the plant's name, on which some agents have said nothing in this round."""
        return sorted(str(port) for port in self._open if port.publisher in agents)
