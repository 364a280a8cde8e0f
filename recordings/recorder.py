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
from collections.abc import Callable, Collection
from typing import Final

import msgspec
from msgspec.structs import replace

from agents.lifeline import Armed, Lifeline, Over, Presence, Recorded, RecordingEnded
from agents.plan import RunPlan
from bus_schemas.codec import decode
from bus_schemas.messages import Message, Ready, Run
from bus_schemas.signals import DISPATCH, READY, Occurrence, Port, ports
from bus_schemas.tree import PLANT, RECORDER, ROOT
from bus_schemas.zenoh_bus import ZenohTap
from recordings.complaints import ABSURD, Complaints
from recordings.external_agents import ExternalAgents
from recordings.lasting_writer import LastingWriter
from recordings.monitor import RunMonitor
from recordings.plausibility import absurdity
from recordings.writer import RunWriter

log = logging.getLogger(__name__)

FLUSH_S: Final = 0.5
"""Time between flushes: as much as a crash can lose."""

_NAP_S: Final = 0.005
_STATUS_S: Final = 0.25
_MOST_AT_ONCE: Final = 2000
_CYCLE_WINDOW: Final = 1000
"""How many cycles ahead of the plant's last word a message can be on another link, generously."""

_EXTERNAL_WINDOW: Final = 20
"""The same of a message of an external agent, which may be of a wrong cycle."""

_REMEMBERED_CYCLES: Final = 100
"""For so many cycles it is known on which ports there was a message: there must be no second."""

_ONCE_A_CYCLE: Final = frozenset({Occurrence.CYCLE, Occurrence.TURN, Occurrence.NEED})

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
        self.gaps: Counter[str] = Counter()
        self._plan = plan
        self._tap = tap
        self._writer = LastingWriter(writer, self._tell_end)
        self._lifeline = lifeline
        self._end = end
        self._attached = attached
        self._external = ExternalAgents(plan)
        self._newest_cycle = -1
        self._stop_cycle: int | None = None
        self._spoken: dict[int, set[Port[Message]]] = {}
        self._next_sequence: dict[Port[Message], int] = {}
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
        if not self._belongs(port, message, key):
            return
        if message.cycle < 0:
            if self._round.sees(port, message.cycle):
                self._answer_round(message)
        elif port.signal.logged:
            self._record(port, message, payload)

    def _belongs(self, port: Port[Message], message: Message, key: str) -> bool:
        """Whether a message is one of the run; else it is complained of."""
        cycle, newest = message.cycle, self._newest_cycle
        external = port.publisher in self._plan.external
        if message.source != port.publisher:
            self.complaints.add(key, "foreign", f"it is from {message.source!r}")
        elif cycle > newest + (_EXTERNAL_WINDOW if external else _CYCLE_WINDOW):
            self.complaints.add(key, "other_cycle", f"it is of cycle {cycle}, this is {newest}")
        elif external and cycle >= 0 and port.publisher != PLANT and not self._round.answered:
            self.complaints.add(key, "other_cycle", f"it is of cycle {cycle}, before the run")
        elif (
            cycle >= 0 and port.signal.occurrence in _ONCE_A_CYCLE and self._is_second(port, cycle)
        ):
            self.complaints.add(key, "duplicate", f"it came twice in cycle {cycle}")
        else:
            return True
        return False

    def _is_second(self, port: Port[Message], cycle: int) -> bool:
        """Whether there was a message of this cycle already, as far as it is remembered."""
        spoken = self._spoken.get(cycle)
        if spoken is None:
            spoken = self._spoken[cycle] = set()
            if len(self._spoken) > _REMEMBERED_CYCLES:
                del self._spoken[min(self._spoken)]
        if port in spoken:
            return True
        spoken.add(port)
        return False

    def _record(self, port: Port[Message], message: Message, payload: bytes) -> None:
        """Write down a message of the run, and follow the run by it."""
        if port.signal is DISPATCH:
            self._newest_cycle = max(message.cycle, self._newest_cycle)
        elif isinstance(message, Run):
            self._follow(message)
        self._external.hear(port, self._count_gap(port, message))
        self._writer.add(port, message, payload, time.monotonic_ns())
        if port.publisher in self._plan.external:
            absurd = absurdity(self._plan, port, message)
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

    def _count_gap(self, port: Port[Message], message: Message) -> int:
        """Return how many messages before this one did not come."""
        gap = max(message.sequence - self._next_sequence.get(port, 0), 0)
        self._next_sequence[port] = message.sequence + 1
        if gap:
            self.gaps[port.signal.name] += gap
        return gap

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
                gaps=dict(self.gaps),
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

    def sees(self, port: Port[Message], cycle: int) -> bool:
        """Take in a message of a round; return whether it was the last one that was missing."""
        if self._cycle is None or cycle > self._cycle:
            self._cycle, self._open = cycle, set(self._all)
            self.count += 1
        if cycle != self._cycle or port not in self._open:
            return False
        self._open.discard(port)
        self.answered = self.answered or not self._open
        return not self._open

    def unheard(self, agents: Collection[str]) -> list[str]:
        """Keys, without the plant's name, on which some agents have said nothing in this round."""
        return sorted(str(port) for port in self._open if port.publisher in agents)
