"""The recorder: hears everything on the bus of a run and writes it down. A process of its own.

If the disk is full it keeps listening, because in lockstep publishers wait for a listener that
falls behind. It also tells the launcher where the run stands, and in the arming rounds it tells the
plant that it hears everybody.
"""

from __future__ import annotations

import logging
import signal
import time
from collections import Counter
from collections.abc import Callable, Collection
from itertools import islice
from math import inf
from pathlib import Path
from typing import Final

import msgspec
from msgspec.structs import replace

from agents.events import Armed, Joined, Over, Presence, Recorded, RecordingEnded
from agents.launcher_link import LauncherLink
from agents.loop import log_drop
from agents.machine import stand_back
from agents.plan import RunPlan
from agents.process import run_guarded, set_up_process
from agents.session import session_settings
from bus_schemas.codec import decode
from bus_schemas.messages import Message, Ready, Run
from bus_schemas.signals import DISPATCH, HELP, PRODUCTION, READY, RUN, Port, ports
from bus_schemas.tree import PLANT, RECORDER, ROOT, agent_name
from bus_schemas.zenoh_bus import ZenohTap
from recordings.read.gaps import due_step
from recordings.read.reader import RunReader
from recordings.read.run_file import RECORDING_NAME, further_file
from recordings.record.external_agents import ExternalAgents
from recordings.record.message_complaints import ABSURD, REPEATED, TWO_SENDERS, Complaints
from recordings.record.monitor import RunMonitor
from recordings.record.plausibility import absurdity
from recordings.record.second_senders import SecondSenders
from recordings.record.writer import ClockAnchor, RunWriter

log = logging.getLogger(__name__)

FLUSH_S: Final = 0.5
"""Time between flushes: the most that a crash can lose."""

_NAP_S: Final = 0.005
_STATUS_S: Final = 0.25
_MOST_AT_ONCE: Final = 2000
_IDLE_S: Final = 2.0
"""How long in all the recorder waits at the end for messages that do not come."""

_MOST_AFTER_END: Final = 100_000
"""How many messages from outside the launcher's processes are still recorded at the end: more than
a flooding device can have waiting (some 45,000 here), but not an endless flood."""

_STOP_WAIT_S: Final = 0.5
"""How long a stop before the run's last cycle may be contradicted by the plant, and more in real
time, before it counts."""

_FAR_AHEAD: Final = 1000
"""A message this many cycles ahead of the dispatch is of a cycle that cannot be."""


def longest_pause_s(plan: RunPlan) -> float:
    """Return how long a controller may say nothing in real time [s]."""
    return max(1.0, 2.0 * plan.cycle_wall_ns / 1e9)


class Head(msgspec.Struct, gc=False):
    """What the recorder reads of every message; the rest is written down undecoded."""

    cycle: int
    source: str
    sim_time_ns: int = 0
    publish_time_ns: int = 0
    sequence: int = 0
    incarnation: int = 0


_decode_head = msgspec.msgpack.Decoder(Head).decode


def run_recorder(plan: RunPlan, folder: Path, link: LauncherLink) -> int:
    """Record a run into its folder until the launcher says so or is gone. Returns the status."""
    # Whatever ends the run, the file must be closed in order.
    link.heed(signal.SIGTERM, signal.SIGHUP)
    set_up_process(plan, RECORDER)

    def run() -> None:
        scenario = (folder / "scenario.toml").read_text(encoding="utf-8")

        def on_end(text: str) -> None:
            log.error("%s", text)
            link.tell(RecordingEnded(text))

        first = path = folder / RECORDING_NAME
        number, anchor, last_cycle = 1, None, -1
        while path.exists():
            number += 1
            path = further_file(first, number)
        if path != first:
            with RunReader(first) as before:
                anchor, last_cycle = ClockAnchor.of(before.metadata, before.path), before.last_cycle
        writer = RunWriter(path, plan, scenario, driver="launch", anchor=anchor, on_end=on_end)
        with ZenohTap(RECORDER, plan.wiring, session_settings(plan, RECORDER)) as tap:
            link.tell(Joined())
            if not plan.lockstep:
                stand_back()
            so_far = first if path != first else None
            Recorder(plan, tap, writer, link, log_drop, so_far, last_cycle).run()

    return run_guarded(RECORDER, link, run)


class Recorder:
    """Writes down a run.

    Of a run that is under way, `first` is the recording so far, up to `last_cycle`.
    """

    def __init__(
        self,
        plan: RunPlan,
        tap: ZenohTap,
        writer: RunWriter,
        link: LauncherLink,
        on_wrong: Callable[[int, str], None],
        first: Path | None = None,
        last_cycle: int = -1,
    ) -> None:
        self.monitor = RunMonitor()
        self.complaints = Complaints(on_wrong, link.tell)
        self._plan = plan
        self._tap = tap
        self._writer = writer
        self._link = link
        self._asked_at: float | None = None
        self._expected: int | None = None
        self._external = ExternalAgents(plan)
        self._tokens = tap.watch_tokens() if plan.elsewhere else None
        self._newest_cycle = last_cycle
        now_ns = time.monotonic_ns()
        nodes = () if plan.lockstep else plan.tree.nodes
        self._heard_ns = {agent_name(node): now_ns for node in nodes}
        self._stop_cycle: int | None = None
        self._over_at = inf
        self._idle_s = 0.0
        self._others_left = _MOST_AFTER_END
        self._senders = SecondSenders(
            (port for port in plan.wiring.ports if port.signal.is_cyclic or port.signal is RUN),
            plan.standbys,
        )
        self._extra: Counter[str] = Counter()
        self._first = first
        self._round = Round(plan)
        self._round.answered = first is not None
        # These are decoded, the others are only written down.
        self._read = {
            port
            for port in plan.wiring.ports
            if port.signal in {DISPATCH, HELP, PRODUCTION, RUN} or port.publisher in plan.elsewhere
        }

    def run(self) -> None:
        """Record until told to end, then close the file and report."""
        flush_at = status_at = time.monotonic()
        while not self._may_end():
            # Flush and status must have their turn, however much comes.
            heard = list(islice(self._tap.drain(), _MOST_AT_ONCE))
            own_before = self._own_heard
            for key, payload in heard:
                self._hear(key, payload)
            if self._asked_at is not None:
                self._others_left -= len(heard) - (self._own_heard - own_before)
            if not heard:
                self._heed_launcher()
                time.sleep(_NAP_S)
                if self._asked_at is not None:
                    self._idle_s += _NAP_S
            now = time.monotonic()
            if now >= flush_at:
                self._writer.flush()
                flush_at = now + FLUSH_S
            if now >= self._over_at and self._stop_cycle is not None:
                self._over_at = inf
                self._link.tell(Over(self._stop_cycle))
            if now >= status_at:
                self._tell_presence()
                self._tell_status()
                self._heed_launcher()
                status_at = now + _STATUS_S
        self._writer.close()
        self._report()

    def _heed_launcher(self) -> None:
        expected = self._link.expected_messages()
        if expected is not None:
            self._expected = expected
        if expected is not None or self._link.dismissed:
            self._ask_end()

    def _ask_end(self) -> None:
        self._asked_at = self._asked_at or time.monotonic()

    def _may_end(self) -> bool:
        """Whether all that is expected has come, or if that is unknown nothing comes any more."""
        asked_at, expected = self._asked_at, self._expected
        if asked_at is None:
            return False
        if expected is None:
            return self._idle_s > FLUSH_S or time.monotonic() > asked_at + _IDLE_S
        # Devices do not say how much they published, and their messages come on other links.
        if self._own_heard >= expected and (
            self._stop_cycle is None or self._external.have_answered(self._stop_cycle)
        ):
            return True
        return self._idle_s > _IDLE_S or self._others_left <= 0

    @property
    def _own_heard(self) -> int:
        """Messages of the launcher's processes that have come."""
        return self._writer.heard - self._external.heard - self._extra.total()

    def _hear(self, key: str, payload: bytes) -> None:
        port = self._plan.wiring.port(key)
        if port is None:
            self.complaints.add(key, "unknown", "this run has no such node or signal")
            return
        try:
            head = _decode_head(payload)
            message = decode(port.signal, payload) if port in self._read else None
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            self.complaints.add(key, "undecodable", str(error))
            return
        if head.source != port.publisher:
            self.complaints.add(key, "foreign", f"it is from {head.source!r}")
        elif head.cycle < 0:
            self._heard_ns[head.source] = time.monotonic_ns()
            if self._round.sees(port, head.cycle):
                ready = Ready(head.cycle, head.sim_time_ns, RECORDER, ())
                self._tap.publish(READY.of(ROOT), ready)
        elif port.signal.logged and not self._is_far_off(key, port, head.cycle):
            self._record(port, head, message, payload)

    def _is_far_off(self, key: str, port: Port[Message], cycle: int) -> bool:
        """Whether a message is of a cycle that cannot be."""
        if port.publisher in self._plan.external:
            is_near = self._round.answered and cycle <= self._newest_cycle + _FAR_AHEAD
            is_far = port.publisher != PLANT and not is_near
        else:
            is_far = cycle > self._plan.cycles
        if not is_far:
            return False
        self.complaints.add(key, "other_cycle", f"it is of cycle {cycle}, not {self._newest_cycle}")
        return True

    def _record(
        self, port: Port[Message], head: Head, message: Message | None, payload: bytes
    ) -> None:
        heard_ns = time.monotonic_ns()
        self._writer.add(port, head, payload, heard_ns)
        self._heard_ns[head.source] = heard_ns
        is_external = port.publisher in self._plan.elsewhere
        wrong = self._senders.see(port, head.cycle, head.incarnation, payload)
        if is_external and message is not None:
            is_first = self._external.hear(port, message)
            if not is_first and port.signal.is_cyclic:
                wrong = wrong or (REPEATED, f"it came again for cycle {message.cycle}")
        if wrong:
            self.complaints.add(self._plan.wiring.key(port), *wrong)
            if not is_external:
                self._extra[port.signal.name] += 1
        elif message is not None:
            absurd = absurdity(self._plan, port, message, heard_ns) if is_external else ""
            if absurd:
                self.complaints.add(self._plan.wiring.key(port), ABSURD, absurd)
            else:
                self._follow(port, message)

    def _follow(self, port: Port[Message], message: Message) -> None:
        if isinstance(message, Run):
            self._heed_run(message)
        elif port.signal is DISPATCH:
            self._newest_cycle = max(message.cycle, self._newest_cycle)
            if self._stop_cycle is not None and self._stop_cycle <= message.cycle:
                self._contradict_stop(self._stop_cycle)
        self.monitor.see(port, message)

    def _heed_run(self, message: Run) -> None:
        """Note the beginning or end of the run; tell the launcher if the plant is external."""
        if message.state == "stop":
            if message.cycle <= self._newest_cycle:
                self._contradict_stop(message.cycle)
                return
            self._stop_cycle = message.cycle
            if self._link.by_hand:  # No launcher will ask it to end.
                self._ask_end()
            if PLANT in self._plan.external:
                wait_s = _STOP_WAIT_S + 1.5e-9 * self._plan.cycle_wall_ns
                is_early = message.cycle < self._plan.cycles
                self._over_at = time.monotonic() + wait_s * is_early
        elif PLANT in self._plan.external:
            self._link.tell(Armed(message.start_time_ns))

    def _contradict_stop(self, cycle: int) -> None:
        """Complain of a stop before a cycle that the plant has begun."""
        self._stop_cycle, self._over_at = None, inf
        text = f"it stops the run before cycle {cycle}, and cycle {self._newest_cycle} has begun"
        self.complaints.add(self._plan.wiring.key(RUN.of(ROOT)), TWO_SENDERS, text)
        if PLANT not in self._plan.external:
            self._extra[RUN.name] += 1

    def _tell_presence(self) -> None:
        """Say which external agents have come or gone, until the run ends and all of them go."""
        for key, alive in self._tokens.changes() if self._tokens is not None else ():
            agent = self._external.named(key)
            if agent is not None and self._stop_cycle is None:
                self._external.note_presence(agent, alive, self._newest_cycle)
                self._link.tell(Presence(agent, alive, self._newest_cycle))

    def _tell_status(self) -> None:
        status = self.monitor.status(self._writer.recorded.total())
        if self._plan.elsewhere and self._newest_cycle < 0:
            status = replace(status, unheard=self._round.unheard(self._plan.elsewhere))
        quiet_since_ns = time.monotonic_ns() - round(longest_pause_s(self._plan) * 1e9)
        silent = [agent for agent, at_ns in self._heard_ns.items() if at_ns < quiet_since_ns]
        if silent and not self._plan.lockstep:
            status = replace(status, silent=silent)
        self._link.tell(status)

    def _report(self) -> None:
        cycles = self._newest_cycle + 1 if self._stop_cycle is None else self._stop_cycle
        recorded, completed, external = self._writer.recorded, self.monitor.cycles, self._external
        if self._first is not None:
            recorded, external = Counter(), ExternalAgents(self._plan)
            with RunReader(self._first) as run:
                for record in run.records():
                    recorded[record.port.signal.name] += 1
                    if record.port.publisher in self._plan.elsewhere:
                        external.hear(record.port, record.message())
            completed = cycles
        self._link.tell(
            Recorded(
                recorded=dict(recorded),
                foreign=self.complaints.set_aside,
                cycles=completed,
                ended_early=self._writer.trouble,
                external=external.accounts(cycles),
                complaints=self.complaints.all(),
                extra=dict(self._extra),
            )
        )


class Round:
    """The arming round under way: which of the messages that always come have been heard."""

    def __init__(self, plan: RunPlan) -> None:
        self._all = frozenset(port for port in ports(plan.tree) if due_step(plan, port))
        self.answered = False
        self._cycle: int | None = None
        self._open: set[Port[Message]] = set()
        self._last: dict[Port[Message], int] = {}

    def sees(self, port: Port[Message], cycle: int) -> bool:
        """Take in a message of a round; return whether it completes the round.

        Only the plant begins a round. A message of a later round is remembered, in case it has
        overtaken the plant's messages.
        """
        if port.publisher == PLANT and (self._cycle is None or cycle > self._cycle):
            self._cycle = cycle
            self._open = {port for port in self._all if self._last.get(port) != cycle}
        self._last[port] = cycle
        if cycle != self._cycle or port not in self._open:
            return False
        self._open.discard(port)
        self.answered = self.answered or not self._open
        return not self._open

    def unheard(self, agents: Collection[str]) -> list[str]:
        """Keys, without the plant's name, on which nothing of some agents came in this round."""
        return sorted(str(port) for port in self._open if port.publisher in agents)
