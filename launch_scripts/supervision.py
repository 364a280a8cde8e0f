"""The launcher's side of its processes: starts, hears and ends them, and finds out what broke."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TypeAlias

import msgspec
import psutil

from agents.cycle import Kind, kind_of, stage_place
from agents.plan import RunPlan
from agents.process.beats import BeatTable
from agents.process.events import (
    Event,
    Exited,
    Failed,
    Finished,
    Joined,
    Recorded,
    Request,
    Signal,
    Started,
    Waiting,
)
from agents.process.launcher_link import Packets, decode_event, packets
from agents.process.side_process import SideProcess
from bus_schemas.errors import FailureError, listed
from bus_schemas.tree import RECORDER
from recordings.read.run_file import log_name

_LOG_LINES: Final = 5
_LARGEST_PACKET: Final = 1 << 18
_MOST_PACKETS: Final = 500

_HEAP: Final = {
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_THRESHOLD_": "32768",
    "MALLOC_TRIM_THRESHOLD_": "131072",
}
"""One heap of glibc in each process, and none of the buffers of Zenoh's links in it. Otherwise a
process grows with the links that end: see docs/decisions/0003-zenoh-tuning.md."""


State: TypeAlias = Literal["awaited", "started", "present", "ended", "given up"]

_STATES: Final[dict[type[Event], State]] = {
    Started: "started",
    Joined: "present",
    Exited: "ended",
}


class ForkServerProcess(SideProcess):
    """The fork server. Start it early: it imports while others prepare.

    beats: Descriptor of the memory in which it and its processes beat.
    """

    def __init__(self) -> None:
        self.control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.beats = os.memfd_create("heliarch-beats")
        self._was_asked = False
        self._unsent: deque[bytes] = deque()
        with theirs:
            super().__init__(
                "launch_scripts.fork_server",
                *(str(theirs.fileno()), str(self.beats)),
                env={
                    **_HEAP,
                    **os.environ,
                    "PYTHONUNBUFFERED": "1",
                    # An import must start no thread: this library would.
                    "OPENBLAS_NUM_THREADS": "1",
                },
                pass_fds=(theirs.fileno(), self.beats),
            )

    def ask(self, request: Request) -> None:
        self._was_asked = True
        self._unsent.extend(packets("", msgspec.json.encode(request)))
        self.send_requests()

    def send_requests(self) -> None:
        """Send requests while there is room, without blocking: the server may not read now.

        To be called again and again: a server that forks hundreds waits until its events are read.
        """
        self.control.setblocking(False)
        with suppress(BrokenPipeError, ConnectionResetError, BlockingIOError):
            while self._unsent:
                self.control.send(self._unsent[0])
                self._unsent.popleft()

    def hang_up(self) -> None:
        """Let it end what is left of its processes, and itself."""
        super().hang_up()
        self.control.close()
        if self.beats >= 0:
            os.close(self.beats)
            self.beats = -1
        if not self._was_asked:  # It has no processes.
            self.process.kill()


@dataclass
class Row:
    """What is known of the life of a process. Times are by the clock of the `Watch`.

    beat_ns, cycle: Of its newest beat.
    beat_at_s, moved_at_s: When that beat, and that cycle, were first seen.
    """

    state: State = "awaited"
    beat_ns: int = 0
    cycle: int = -1
    beat_at_s: float = 0.0
    moved_at_s: float = 0.0


@dataclass
class Child:
    """One process of a run: its row of the table, and the newest event of each kind it sent."""

    agent: str
    kind: Kind
    log: Path
    row: Row
    pid: int = 0
    finished: Finished | None = None
    recorded: Recorded | None = None
    waiting: Waiting | None = None
    failed: Failed | None = None
    exited: Exited | None = None
    cpu_at_start_s: float | None = None

    @property
    def ready(self) -> bool:
        """Whether it is on the bus."""
        return self.row.state == "present"

    def begin_again(self) -> None:
        """Forget all events of its process, which has ended, but not its processor time."""
        self.pid, self.cpu_at_start_s = 0, -(self.cpu_in_run_s() or 0.0)
        self.finished = self.waiting = self.failed = self.exited = self.recorded = None

    def note(self, event: Event) -> None:
        self.row.state = _STATES.get(type(event), self.row.state)
        match event:
            case Started():
                self.pid = event.pid
            case Finished() | Recorded() | Waiting() | Failed() | Exited():
                setattr(self, type(event).__name__.lower(), event)  # Each has a field of its name.

    def cpu_s(self) -> float | None:
        """Return its processor time so far; None if it is not known."""
        if self.exited is not None:
            return self.exited.cpu_s
        try:
            times = psutil.Process(self.pid).cpu_times()
        except psutil.Error:
            return None
        return float(times.user + times.system)

    def cpu_in_run_s(self) -> float | None:
        """Return its processor time from cycle 0 on, also of processes that it replaced."""
        cpu_s = self.cpu_s()
        if cpu_s is None or self.cpu_at_start_s is None:
            return None
        return cpu_s - self.cpu_at_start_s

    def is_stopped(self) -> bool:
        try:
            return bool(psutil.Process(self.pid).status() == psutil.STATUS_STOPPED)
        except psutil.Error:
            return False


def has_exited(child: Child) -> bool:
    return child.exited is not None


def is_through(child: Child) -> bool:
    """Whether a process has come to the end of the run, or of itself."""
    return bool(child.finished or child.recorded or child.exited)


class Children:
    """The processes of some agents of a run. Leaving the context ends those that still run.

    table: Where they beat.
    phase: When it is now, for messages about those that end.
    on_death: Called with each process that ends before its time, and how; returns whether the run
        goes on.
    """

    def __init__(
        self, server: ForkServerProcess, plan: RunPlan, agents: Sequence[str], logs: Path
    ) -> None:
        self.server = server
        self.table = BeatTable(server.beats, plan.processes)
        self.by_agent = {
            agent: Child(agent, kind_of(agent, plan.tree), logs / log_name(agent), Row())
            for agent in agents
        }
        self.phase = "before cycle 0"
        self.on_death: Callable[[Child, str], bool] = lambda child, why: False
        self._reader = Packets()
        self._asked_to_end: set[str] = set()
        self._server_failure = ""

    def __enter__(self) -> Children:
        return self

    def __exit__(self, *error: object) -> None:
        # Then the server ends the recorder in order, so that its file is whole, others at once.
        self.server.close()

    def __getitem__(self, agent: str) -> Child:
        return self.by_agent[agent]

    def __iter__(self) -> Iterator[Child]:
        return iter(self.by_agent.values())

    def events(self, timeout_s: float) -> list[tuple[Child, Event]]:
        """Return what the processes say within a time; note what they report of themselves."""
        self.server.send_requests()
        heard: list[tuple[Child, Event]] = []
        is_server_gone = self.server.process.poll() is not None
        for packet in self._packets(timeout_s):
            is_server_gone |= not packet
            if (found := self._reader.feed(packet)) is None:
                continue
            agent, event = found[0], decode_event(found[1])
            if agent in self.by_agent:
                self[agent].note(event)
                heard.append((self[agent], event))
            elif isinstance(event, Failed):
                self._server_failure = event.text
        if is_server_gone:
            server = f"the fork server (process {self.server.process.pid})"
            why = self._server_failure or "it was killed or ended by itself"
            raise FailureError(f"{server} is gone, and with it all processes of the run: {why}")
        for child in {child.agent: child for child, event in heard if child.exited}.values():
            why = self._why_ended_early(child)
            if why and not self.on_death(child, why):
                raise self.failure(child.agent, why)
        return heard

    def _packets(self, timeout_s: float) -> Iterator[bytes]:
        """Yield what comes within a time; an empty packet if the server is gone."""
        control = self.server.control
        control.settimeout(timeout_s)
        for _ in range(_MOST_PACKETS):
            try:
                packet = control.recv(_LARGEST_PACKET)
            except (TimeoutError, BlockingIOError):
                return
            except ConnectionResetError:
                packet = b""
            control.settimeout(0.0)
            yield packet
            if not packet:
                return

    def controllers(self) -> list[Child]:
        """Return all processes but the recorder."""
        return [child for child in self if child.agent != RECORDER]

    def failure(self, agent: str, text: str) -> FailureError:
        """Return a failure that an agent is to blame for, with the last lines of its log."""
        if agent not in self.by_agent:
            return FailureError(f"{text} ({agent} is external)")
        log = self[agent].log
        said = log.read_text(encoding="utf-8", errors="replace") if log.exists() else ""
        lines = "".join(f"\n  | {line}" for line in said.splitlines()[-_LOG_LINES:])
        return FailureError(f"{text}; last lines of {log}:{lines}" if lines else text)

    def end_recorder(self, messages: int) -> None:
        """Let the recorder close its file once it has so many messages."""
        self._asked_to_end.add(RECORDER)
        self.table.expect(messages)

    def ask_to_end(self, children: Iterable[Child]) -> None:
        """Let processes end in order, also those that did not hear that the run is over."""
        agents = [child.agent for child in children]
        self._asked_to_end.update(agents)
        self.signal(agents, signal.SIGTERM)

    def signal(self, agents: Sequence[str], number: signal.Signals) -> None:
        """Send a signal to the processes of some agents, unless they have ended."""
        self.server.ask(Signal(tuple(agents), int(number)))

    def await_end(
        self,
        children: list[Child],
        timeout_s: float,
        is_done: Callable[[Child], bool] = has_exited,
        look: Callable[[], list[tuple[Child, Event]]] | None = None,
    ) -> list[Child]:
        """Wait until processes are done or send no events any more; return those that are not done.

        look: Called again and again; returns what `events` has returned.
        """
        until = time.monotonic() + timeout_s
        while left := [child for child in children if not is_done(child)]:
            if any(child in children for child, _ in (look() if look else self.events(0.02))):
                until = time.monotonic() + timeout_s
            if time.monotonic() > until:
                break
        return left

    def _why_ended_early(self, child: Child) -> str:
        """Say how a process that has ended did so before its time; empty if it was in time."""
        asked, exited = child.agent in self._asked_to_end, child.exited
        if child.failed is not None:
            return f"{child.agent} gave up: {child.failed.text}"
        if child.recorded is not None or (child.finished and child.finished.dismissed):
            how = "" if asked else "was ended by SIGTERM"
        elif exited is None or child.finished or (asked and exited.status == -signal.SIGTERM):
            how = ""  # If it was asked, it had hardly begun.
        else:
            code = exited.status
            how = f"was killed by signal {-code}" if code < 0 else f"ended ({code})"
        return f"{child.agent} (process {child.pid}) {how} {self.phase}" if how else ""


def who_waits(
    waiting: Mapping[str, Waiting], plan: RunPlan, stopped: Collection[str] = ()
) -> tuple[str, list[str]]:
    """Return one line on which processes of a stalled run wait for which, and those to blame.

    To blame are processes that a signal has stopped; else those that others wait for and that do
    not wait in the same cycle themselves; else who waits in the earliest stage: all that it needs
    has been sent.
    """
    first = min(event.cycle for event in waiting.values())
    stuck = {agent: event for agent, event in waiting.items() if event.cycle == first}
    needed: dict[str, list[str]] = {}
    for agent, event in stuck.items():
        for port, publisher in event.needs:
            process = plan.wiring.process_of(publisher)
            needed.setdefault(process, []).append(f"{agent} waits for {port}")
    places = {name: stage_place(name, one.stage, plan.tree) for name, one in stuck.items()}
    earliest = [agent for agent, place in places.items() if place == min(places.values())]
    to_blame = [*stopped] or [agent for agent in needed if agent not in stuck] or earliest
    what = "stopped by a signal:" if stopped else "nothing that can be used came from"
    waits = [line for agent in to_blame for line in needed.get(agent, ())]
    if to_blame is earliest:
        what, waits = "what they wait for was sent to", []
    line = f"stalled in cycle {first}: {what} {listed(to_blame)}"
    return "; ".join(filter(None, (line, listed(waits)))), to_blame


def still_waiting(children: Iterable[Child]) -> list[Child]:
    """Return the processes that said that they wait and have not gone on since."""
    waiting = [child for child in children if child.waiting is not None]
    for child in waiting:
        if child.waiting is not None and child.row.cycle > child.waiting.cycle:
            child.waiting = None
    return [child for child in waiting if child.waiting is not None]


def stall(children: Children, plan: RunPlan) -> tuple[str, list[str]]:
    """Say in one line why the run of some processes stalls; return it with those to blame."""
    waiting = {child.agent: child.waiting for child in children if child.waiting is not None}
    stopped = [child.agent for child in children if child.is_stopped()]
    return who_waits(waiting, plan, stopped)
