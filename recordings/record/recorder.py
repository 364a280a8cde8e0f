"""The recorder: hears everything on the bus of a run and writes it down. A process of its own.

If the disk is full it keeps listening, because in lockstep publishers wait for a listener that
falls behind. It also tells the launcher where the run stands, and in the arming rounds it tells the
plant that it hears everybody.
"""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from agents.plan import RunPlan
from agents.process.agent_process import run_guarded, set_up_process
from agents.process.events import Joined, Over, Presence, Recorded, Remark
from agents.process.launcher_link import LauncherLink
from agents.process.machine import own_memory_mb, stand_back
from agents.process.session import session_settings
from bus_schemas.signals import READY
from bus_schemas.tree import RECORDER, ROOT
from bus_schemas.zenoh_session import RunSubscriber
from recordings.read.mcap_file import read_outline
from recordings.read.run_file import RECORDING_NAME, next_path
from recordings.record.listener import RunListener
from recordings.record.phases import Closing
from recordings.record.writer import ClockAnchor, RunWriter

log = logging.getLogger(__name__)

FLUSH_S: Final = 0.5
"""Time between flushes: the most that a crash can lose."""

_NAP_S: Final = 0.005
_SHORT_NAP_S: Final = 0.0005
"""Beside devices, which are measured by when their messages arrive here."""
_LONG_NAP_S: Final = 0.02
"""In lockstep, which no clock measures: to wake costs as much as some messages."""
_STATUS_S: Final = 0.25
_LONGEST_WORK_S: Final = 0.1
"""Without a beat. A bundle may have hundreds of messages, so their number says little."""


def run_recorder(plan: RunPlan, folder: Path, link: LauncherLink) -> int:
    """Record a run into its folder until the launcher says so or is gone. Returns the status."""
    # Whatever ends the run, the file must be closed in order.
    link.end_on(signal.SIGTERM, signal.SIGHUP)
    set_up_process(plan, RECORDER)

    def run() -> None:
        scenario = (folder / "scenario.toml").read_text(encoding="utf-8")

        def on_end(text: str) -> None:
            log.error("%s", text)
            link.tell(Remark(f"{text}; the run goes on without it"))

        # The bus comes first: messages wait in it, and no process waits for a file.
        settings = session_settings(plan, RECORDER)
        with RunSubscriber(RECORDER, plan.wiring, settings) as subscriber:
            if not plan.timing.lockstep:
                stand_back()
            path, anchor = next_file(folder / RECORDING_NAME)
            writer = RunWriter(path, plan, scenario, driver="launch", anchor=anchor, on_end=on_end)
            recorder = Recorder(plan, subscriber, writer, link)
            link.tell(Joined())  # From now on it must beat: a file for 10,000 inverters takes time.
            recorder.run()

    return run_guarded(RECORDER, link, run)


def next_file(first: Path) -> tuple[Path, ClockAnchor | None]:
    """Return the file to write, and the clock anchor of the run's first file, which all share."""
    path = next_path(first)
    if path == first:
        return path, None
    with first.open("rb") as file:
        metadata = read_outline(file, chunks=False).metadata
    if "clock_anchor" in metadata:
        return path, ClockAnchor.of(metadata, first)
    first.unlink()  # It is of a recorder that was killed at once, and holds nothing.
    return first, None


class Recorder:
    """Writes down a run until its end, and tells the launcher where it stands."""

    def __init__(
        self,
        plan: RunPlan,
        subscriber: RunSubscriber,
        writer: RunWriter,
        link: LauncherLink,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._plan = plan
        self._subscriber = subscriber
        self._writer = writer
        self._link = link
        self._now_ns = now_ns
        self._sleep = sleep
        self._nap_s = _SHORT_NAP_S if plan.access.external else _NAP_S
        if plan.timing.lockstep:
            self._nap_s = _LONG_NAP_S
        self._closing = Closing(has_others=bool(plan.elsewhere))
        self._tokens = subscriber.watch_tokens() if plan.elsewhere else None
        wiring = plan.wiring
        self._agents_of = {wiring.alive_key(name): of for name, of in wiring.members.items()}
        self._listener = RunListener(plan, writer, link.tell, now_ns, joins_late=link.starts > 0)

    def run(self) -> None:
        closing, listener, progress = self._closing, self._listener, self._listener.progress
        now = flush_at = status_at = self._now_s()
        while not closing.is_over(now, listener.own_heard):
            # Flush and status must have their turn, however much comes.
            heard, own_before = 0, listener.own_heard
            for key, payload in self._subscriber.drain():
                heard += 1
                if (ready := listener.hear(key, payload)) is not None:
                    self._subscriber.publish(READY.of(ROOT), ready)
                if self._now_s() > now + _LONGEST_WORK_S:
                    break
            quiet_s = 0.0 if heard else self._nap_s
            # A bundle has many messages, but all are of the launcher's processes.
            closing.note(max(0, heard - (listener.own_heard - own_before)), quiet_s)
            if not heard:
                self._ask_launcher()
                self._sleep(self._nap_s)
            now = self._now_s()
            self._link.beat(progress.newest_cycle)
            if now >= flush_at:
                self._writer.flush()
                flush_at = now + FLUSH_S
            if progress.is_newly_over(now) and progress.stop_cycle is not None:
                self._link.tell(Over(progress.stop_cycle))
            if now >= status_at:
                self._tell_status()
                self._ask_launcher()
                status_at = now + _STATUS_S
        self._writer.close()
        self._link.tell(self._account())

    def _now_s(self) -> float:
        return self._now_ns() / 1e9

    def _ask_launcher(self) -> None:
        closing, link = self._closing, self._link
        expected = link.expected_messages()
        if expected is not None:
            closing.expected = expected
        if expected is not None or link.dismissed:
            closing.ask(self._now_s())

    def _tell_status(self) -> None:
        progress = self._listener.progress
        if self._tokens is not None and progress.stop_cycle is None:  # At the end all of them go.
            for key, alive in self._tokens.changes():
                for agent in self._agents_of.get(key, ()):
                    if agent in self._plan.elsewhere:
                        self._link.tell(Presence(agent, alive, progress.newest_cycle))
        self._link.tell(self._listener.status())

    def _account(self) -> Recorded:
        """Return the account of this recorder's file."""
        listener = self._listener
        progress = listener.progress
        cycles = progress.cycles if self._link.starts else progress.completed
        return Recorded(
            recorded=dict(self._writer.recorded),
            foreign=listener.complaints.set_aside,
            cycles=cycles,
            ended_early=self._writer.ended_early,
            complaints=listener.complaints.all(),
            extra=dict(listener.senders.extra),
            own_mb=own_memory_mb(),
        )
