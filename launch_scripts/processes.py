"""The owner of a run's processes: it starts, watches and ends them.

A process lives if it beats. Time counts only while the launcher itself runs: a launcher or a
machine that stood still proves nothing. Of external agents only the liveliness token is known.
"""

from __future__ import annotations

import selectors
import signal
import socket
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import Final, TypeAlias

import msgspec

from agents.cycle import kind_of
from agents.faults import incidents
from agents.plan import RunPlan
from agents.process.beats import BEAT_S, FORK_SERVER, BeatTable
from agents.process.events import (
    Armed,
    Event,
    Exited,
    Failed,
    Finished,
    Joined,
    Presence,
    Recorded,
    Request,
    SendSignal,
    Start,
    Started,
    Status,
    Waiting,
)
from agents.process.launcher_link import decode_event
from agents.process.session import link_times
from bus_schemas.errors import FailureError, listed
from bus_schemas.tree import OPERATOR, PLANT, RECORDER
from launch_scripts.fork_server_process import ForkServer
from launch_scripts.process_record import Process, has_exited
from launch_scripts.run_folder import RunFolder
from recordings.read.run_file import log_name

_LOG_LINES: Final = 5
_LARGEST_READ: Final = 1 << 18
_LARGEST_EVENT: Final = 1 << 16

_LONGEST_STEP_S: Final = 0.5
"""The most time that counts between two looks of the launcher."""

_LOOK_S: Final = 0.2

START_S: Final = 10.0
START_PER_AGENT_S: Final = 0.003
"""Before cycle 0: how long no process may come onto the bus and no agent answer for the first time.
While others move, a busy machine may take its time."""

SILENT_S: Final = 5.0
"""A fork server without a beat for this time stands still; a plant, after twice that."""

_SPARE_S: Final = 1.0
"""For the first messages over a link that was closed and opened anew."""

GONE_S: Final = 2.0
"""How long a run waits for an external agent without which it cannot go on."""

_RETURN_S: Final = 10.0
"""In lockstep: how long a process that was started again may take to join."""

_KILLS_APART_S: Final = 1.0
"""Time between two kills of processes that no signal has stopped. On an overloaded machine many
healthy ones seem dead at once, and each death makes more work."""

_SAME_CLOCK_S: Final = 10.0
"""If cycle 0 began farther from now, it was by the clock of another host."""

_SIGNALS: Final = {"kill": signal.SIGKILL, "freeze": signal.SIGSTOP, "thaw": signal.SIGCONT}

_Heard: TypeAlias = "Iterator[tuple[Process, Event]]"


class Processes:
    """All processes of a run. Leaving the context ends those that still run.

    say: Shows a line to the user.

    ran_s: How long the launcher has run [s].
    given_up: Processes that are not started again, and the plant's cycle at that time.
    never_heard: Before cycle 0: some agents that have not answered yet, and their number.
    """

    def __init__(
        self,
        server: ForkServer,
        plan: RunPlan,
        names: Sequence[str],
        folder: RunFolder,
        say: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.server = server
        self.table = BeatTable(server.beats, plan.processes)
        self.ran_s = 0.0
        self.given_up: dict[str, int] = {}
        self.never_heard: tuple[Sequence[str], int] = ((), 0)
        self._plan = plan
        self._folder = folder
        self._say = say
        self._now_s = now_s
        self._by_name = {
            name: Process(name, kind_of(name, plan.tree), folder.logs / log_name(name))
            for name in names
        }
        for name in plan.elsewhere:
            outsider = Process(name, kind_of(name, plan.tree), Path(), is_external=True)
            self._by_name.setdefault(name, outsider)
        self._begun_at_s = inf  # Cycle 0, monotonic.
        self._is_over = False
        self._moved_at_s = 0.0
        self._looked_at_s = now_s()
        self._judge_at_s = 0.0
        self._kill_at_s = 0.0
        self._server_beat = (0, 0.0)
        self._server_stood_still = False
        self._server_failed = ""
        self._requests: deque[bytes] = deque()
        self._incidents = incidents(plan.faults.rules, plan.tree, plan.wiring)
        self._start_s = START_S + START_PER_AGENT_S * len(plan.tree.nodes)
        self._frozen_s = plan.supervision.restart.frozen_s + BEAT_S
        # In lockstep a cycle may take any time.
        self._cycle_s = 3.0e-9 * plan.timing.cycle_wall_ns + self._frozen_s
        # Where links are cut by a fault rule, not being heard proves nothing.
        self._judges_hearing = plan.restarts and not plan.link_faults
        self._unheard_s = sum(link_times(plan)) + _SPARE_S
        self._ready = selectors.DefaultSelector()
        self._ready.register(server.control, selectors.EVENT_READ, None)

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *error: object) -> None:
        # Then the server ends the recorder in order, so that its file is whole, others at once.
        self.server.end()
        self._ready.close()
        for process in self.own:
            if process.link is not None:
                process.link.close()

    def __getitem__(self, name: str) -> Process:
        return self._by_name[name]

    def __contains__(self, name: str) -> bool:
        """Whether it is a process of the launcher's own."""
        return name in self._by_name and not self._by_name[name].is_external

    @property
    def own(self) -> list[Process]:
        return [process for process in self._by_name.values() if not process.is_external]

    def controllers(self) -> list[Process]:
        return [process for process in self.own if process.name != RECORDER]

    def restarts(self) -> Counter[str]:
        return Counter({one.name: len(one.starts_s) for one in self.own if one.starts_s})

    @property
    def newest_cycle(self) -> int:
        return max(self.table.read(PLANT).cycle, 0)

    @property
    def lost_any(self) -> bool:
        """Whether a process ended without saying what it had published."""
        return any(one.starts_s or one.was_killed for one in self.own) or bool(self.given_up)

    # Beginning and end --------------------------------------------------------------------------

    def start(self) -> None:
        for process in self.own:
            self._start(process)

    def begin(self, start_s: float) -> None:
        """Cycle 0 begins: from now on fault rules act, and processor time counts."""
        now_s = self._now_s()
        self._begun_at_s = start_s if abs(start_s - now_s) < _SAME_CLOCK_S else now_s
        for process in self._by_name.values():
            if process.state == "armed":
                process.become("running")
            if process.pid:
                process.cpu_before_s = process.cpu_s()

    @property
    def has_begun(self) -> bool:
        return self._begun_at_s < inf

    def end(self) -> None:
        """Start no more processes."""
        self._is_over = True
        for process in self.own:
            process.begins_at_s = inf

    def end_recorder(self, messages: int) -> None:
        """Let the recorder close its file once it has this number of messages."""
        self[RECORDER].asked_to_end = True
        self.table.expect(messages)

    def ask_to_end(self, some: Iterable[Process]) -> None:
        for process in some:
            process.asked_to_end = True
            self.table.dismiss(process.name)

    def end_by_force(self, some: Iterable[Process]) -> None:
        for process in some:
            self._say(f"{process.name} (process {process.pid}) did not end with the run: killed")
            if not process.is_through:
                self.given_up.setdefault(process.name, max(process.beat.cycle, 0))
            self._send(process, signal.SIGKILL)

    def await_end(
        self,
        some: list[Process],
        timeout_s: float,
        is_done: Callable[[Process], bool] = has_exited,
        look: Callable[[], list[tuple[Process, Event]]] | None = None,
    ) -> list[Process]:
        """Wait until processes are done or send no events any more; return those not done."""
        until = time.monotonic() + timeout_s
        while left := [process for process in some if not is_done(process)]:
            if any(process in some for process, _ in (look or self.look)()):
                until = time.monotonic() + timeout_s
            if time.monotonic() > until:
                break
        return left

    # What they say ------------------------------------------------------------------------------

    def look(self, timeout_s: float = 0.1) -> list[tuple[Process, Event]]:
        """Take in what the processes say, do what is due, and return what they said.

        Raises FailureError: the run cannot go on.
        """
        self._send_requests()
        heard = list(self._events(timeout_s))
        now_s = self._now_s()
        self.ran_s += min(now_s - self._looked_at_s, _LONGEST_STEP_S)
        self._looked_at_s = now_s
        for process in self.own:
            if process.begins_at_s <= now_s:
                process.begins_at_s = inf
                self._start(process)
        if not self._is_over:
            self._carry_out_faults(now_s)
        if self.ran_s >= self._judge_at_s:
            self._judge_at_s = self.ran_s + _LOOK_S
            self._judge()
        return heard

    def _events(self, timeout_s: float) -> _Heard:
        is_gone = self.server.side.process.poll() is not None
        for key, _ in self._ready.select(timeout_s):
            if key.data is not None:
                yield from self._said(key.data)
                continue
            while (packet := self._packet()) is not None:
                if not packet[0]:
                    is_gone = True
                    break
                yield from self._heard(*packet)
        if is_gone:
            why = self._server_failed or "it was killed or ended by itself"
            what = f"the {self.server.name} is gone, and with it all processes of the run"
            raise FailureError(f"{what}: {why}")

    def _packet(self) -> tuple[bytes, list[int]] | None:
        """Return an event of the server, with a link; an empty one if it is gone; None: none."""
        try:
            event, links, *_ = socket.recv_fds(self.server.control, _LARGEST_EVENT, 1)
        except BlockingIOError:
            return None
        except ConnectionResetError:
            return b"", []
        return event, links

    def _heard(self, packet: bytes, links: list[int]) -> _Heard:
        event = decode_event(packet)
        if isinstance(event, Failed):
            self._server_failed = event.text
        if not isinstance(event, Started | Exited):
            return
        process = self[event.agent]
        if isinstance(event, Exited):
            yield from self._said(process, to_the_end=True)
        for link in links:
            process.link = socket.socket(fileno=link)
            process.link.setblocking(False)
            self._ready.register(process.link, selectors.EVENT_READ, process)
        yield process, self._note(process, event)

    def ask(self, request: Request) -> None:
        """Ask the fork server for something."""
        self._requests.append(msgspec.json.encode(request))
        self._send_requests()

    def _send_requests(self) -> None:
        """Send requests while there is room, without blocking.

        A server that forks hundreds does not read before its events are read.
        """
        with suppress(BrokenPipeError, ConnectionResetError, BlockingIOError):
            while self._requests:
                self.server.control.send(self._requests[0])
                self._requests.popleft()

    def _said(
        self, process: Process, *, to_the_end: bool = False
    ) -> Iterator[tuple[Process, Event]]:
        while process.link is not None:
            try:
                data = process.link.recv(_LARGEST_READ)
            except BlockingIOError:
                return
            except ConnectionResetError:
                data = b""
            if not data:
                self._hang_up(process)
                return
            *lines, process.unread = (process.unread + data).split(b"\n")
            for line in lines:
                event = decode_event(line)
                yield process, self._note(process, event)
            if not to_the_end:
                return

    def _note(self, process: Process, event: Event) -> Event:
        match event:
            case Started():
                process.pid = event.pid
                process.beat_at_s = process.moved_at_s = self._moved_at_s = self.ran_s
            case Joined():
                process.become("running" if self.has_begun else "armed")
                process.beat_at_s = process.moved_at_s = self._moved_at_s = self.ran_s
            case Waiting() | Finished() | Recorded() | Failed() | Exited():
                setattr(process, type(event).__name__.lower(), event)  # Each has a field.
                if isinstance(event, Exited):
                    process.become("ended")
                    self._died(process)
            case Armed():
                self.begin(event.start_time_ns / 1e9)
            case Presence():
                self._note_presence(self[event.agent], event)
            case Status():
                self._note_status(event)
        return event

    def _note_status(self, status: Status) -> None:
        if status.never_heard[1] != self.never_heard[1]:
            self._moved_at_s = self.ran_s
        self.never_heard = status.never_heard
        if self._judges_hearing and self.has_begun and not self._is_over:
            self._judge_hearing(set(status.not_heard))

    # External agents ----------------------------------------------------------------------------

    @property
    def awaited(self) -> list[str]:
        return [
            one.name
            for one in self._by_name.values()
            if one.is_external and one.state == "starting"
        ]

    def _note_presence(self, process: Process, event: Presence) -> None:
        agent, plan = process.name, self._plan
        lockstep = plan.timing.lockstep
        name = f"{agent} ({plan.access.addresses.get(agent, 'external')})"
        when = f"in cycle {event.cycle}" if event.cycle >= 0 else "before cycle 0"
        self._moved_at_s = self.ran_s
        if not event.alive:
            if process.is_there:
                process.become("ended")
            if event.cycle >= 0 and (agent == OPERATOR or (not lockstep and agent != PLANT)):
                when += "; the run goes on without it"
            elif event.cycle >= 0 and agent in plan.access.external:
                process.gone_at_s = self._now_s()
            self._say(f"{name} is gone {when}")
            return
        if not lockstep:  # There no message is sent twice: a returning agent lacks some.
            process.gone_at_s = inf
        was_here = process.state == "ended"
        if was_here:
            process.become("starting")
        process.become("running" if self.has_begun else "armed")
        self._say(f"{name} is back {when}" if was_here else f"{name} is here")

    def lost_external(self) -> FailureError | None:
        for one in self._by_name.values():
            if self._now_s() > one.gone_at_s + GONE_S:
                text = f"{one.name} is gone: the run cannot go on without it"
                return self.failure(one.name, text)
        return None

    # Life ---------------------------------------------------------------------------------------

    @property
    def server_stands_still(self) -> bool:
        beat_ns, at_s = self._server_beat
        return beat_ns > 0 and self.ran_s - at_s > SILENT_S

    def is_present(self, process: Process) -> bool:
        return process.is_there and self.ran_s - process.beat_at_s < SILENT_S

    def _judge(self) -> None:
        beat_ns = self.table.read(FORK_SERVER).time_ns
        if beat_ns != self._server_beat[0]:
            self._server_beat = beat_ns, self.ran_s
        if self.server_stands_still != self._server_stood_still:
            self._server_stood_still ^= True
            does = "stands still" if self._server_stood_still else "goes on"
            self._say(f"the {self.server.name} {does}")
        is_judged = self._plan.restarts or self._plan.timing.lockstep or not self.has_begun
        for process in self.own:
            old, process.beat = process.beat, self.table.read(process.name)
            if process.beat.time_ns != old.time_ns:
                process.beat_at_s = self.ran_s
                if process.beat.cycle != old.cycle:
                    process.moved_at_s = self.ran_s
            if why := self._objection(process):
                if process.kind == "plant":
                    raise self.failure(PLANT, f"plant (process {process.pid}) {why}")
                if is_judged or process.kind == "recorder":
                    self._kill(process, why)

    def _objection(self, process: Process) -> str:
        """Say why a process does not live; empty if it does."""
        beat, plant_s = process.beat, 2.0 * SILENT_S if process.kind == "plant" else 0.0
        # In lockstep a process that sends waits for a listener.
        if process.is_through or not process.pid or beat.sends:
            return ""
        if process.state == "starting":
            idle_s = self.ran_s - max(process.beat_at_s, self._moved_at_s)
            if idle_s <= self._start_s or not any(one.is_there for one in self.own):
                return ""
            return f"has not come onto the bus for {self._start_s:.0f} s"
        limit_s = max(self._frozen_s, plant_s)
        if self.ran_s - process.beat_at_s > limit_s:
            return f"has not beaten for {limit_s:.1f} s"
        is_in_cycle = 0 <= beat.cycle < self._plan.timing.cycles and process.kind != "recorder"
        if self._plan.timing.lockstep or not is_in_cycle:
            return ""
        stuck_s = self.ran_s - process.moved_at_s
        return f"beats and stays in cycle {beat.cycle}" if stuck_s > self._cycle_s + plant_s else ""

    def _judge_hearing(self, not_heard: set[str]) -> None:
        """Start live processes again that no listener has heard for long."""
        for process in self.own:
            lives = process.is_there and not process.is_through
            if not lives or self.ran_s - process.beat_at_s > 2.0 * BEAT_S:
                continue
            if process.name not in not_heard:
                process.unheard_since_s, process.unheard_in_a_row = None, 0
            elif process.unheard_since_s is None:
                process.unheard_since_s = self.ran_s
            elif process.kind != "plant":
                self._replace_unheard(process, self.ran_s - process.unheard_since_s)

    def _replace_unheard(self, process: Process, unheard_s: float) -> None:
        """Kill a process; wait twice as long each time, and give it up at last."""
        policy, in_a_row = self._plan.supervision.restart, process.unheard_in_a_row
        limit_s = self._unheard_s * 2.0**in_a_row
        if unheard_s <= limit_s:
            return
        if self._kill(process, f"lives, and no listener has heard it for {limit_s:.0f} s"):
            process.stays_away = policy.when != "always" and in_a_row >= policy.most
            process.unheard_since_s = None
            process.unheard_in_a_row += 1

    def mends(self, to_blame: Sequence[str]) -> bool:
        """In lockstep: kill processes that a stalled run waits for, or wait for their return."""
        if self._is_over or PLANT not in self:
            return False
        for name in to_blame:
            if name not in self or self[name].kind in {"plant", "recorder"}:
                return False
            process = self[name]
            if process.state == "given up":
                continue
            if self._now_s() - max(process.starts_s, default=0.0) > _RETURN_S:
                self._kill(process, "does not go on")
        return True

    def stuck_start(self) -> FailureError | None:
        """Before cycle 0: return a failure that names the missing, if nothing moves for long."""
        if self.ran_s - self._moved_at_s <= self._start_s:
            return None
        absent = [one for one in self.own if not one.is_there]
        if absent:
            has_hope = len(absent) < len(self.own) and any(not one.starts_s for one in absent)
            if has_hope:  # A process that hangs is started again once.
                return None
            missing = listed([one.name for one in absent], most=3)
            text = f"in {self._start_s:.0f} s nobody came onto the bus; missing: {missing}"
            return self.failure(absent[0].name, text)
        names, number = self.never_heard
        if not number:
            return None  # All have answered once; the plant says what it waits for.
        others = f" and {number - len(names)} more" if number > len(names) else ""
        text = f"in {self._start_s:.0f} s of arming nothing came from {', '.join(names)}{others}"
        return self.failure(names[0] if names[0] in self else RECORDER, text)

    def still_waiting(self) -> list[Process]:
        """Return the processes that said that they wait and have not gone on since."""
        for process in self.own:
            if process.waiting is not None and process.beat.cycle > process.waiting.cycle:
                process.waiting = None
        return [process for process in self.own if process.waiting is not None]

    # Death --------------------------------------------------------------------------------------

    def failure(self, name: str, text: str) -> FailureError:
        """Return a failure with the last lines of the log of the process that is to blame."""
        if name not in self:
            return FailureError(f"{text} ({name} is external)")
        log = self[name].log
        said = log.read_text(encoding="utf-8", errors="replace") if log.exists() else ""
        lines = "".join(f"\n  | {line}" for line in said.splitlines()[-_LOG_LINES:])
        return FailureError(f"{text}; last lines of {log}:{lines}" if lines else text)

    def _died(self, process: Process) -> None:
        """Start a process again that has ended before its time, or give it up.

        Raises FailureError: the run cannot go on without it.
        """
        why, name, now_s = self._why_ended_early(process), process.name, self._now_s()
        if not why:
            return
        was_killed = process.was_killed
        gave_up_before = process.failed is not None and not self.has_begun
        if process.kind == "plant" or gave_up_before:
            raise self.failure(name, why)
        if self._is_over:
            process.was_killed = True
            if not was_killed:
                self._say(why)
            return
        # Before cycle 0, and of the recorder, a new process is as good as the first one.
        may_return = self._plan.restarts or not self.has_begun or name == RECORDER
        if name == RECORDER and not self._folder.path.is_dir():
            why, may_return = f"{why}, and the run's folder has been removed", False
        policy = self._plan.supervision.restart
        wait_s = policy.wait_s(process.starts_s, now_s) if may_return else None
        if wait_s is None or process.stays_away:
            self._give_up(process, why)
            return
        process.starts_s.append(now_s)
        if not was_killed:
            self._say(f"{why}; it is started again")
        process.begins_at_s = now_s + wait_s
        self._moved_at_s = self.ran_s  # A new process has its own time to come.

    def _why_ended_early(self, process: Process) -> str:
        """Say how a process ended before its time; empty if it was in time."""
        name, exited, asked = process.name, process.exited, process.asked_to_end
        phase = "at the end of the run" if self._is_over else "in the middle of the run"
        when = phase if self.has_begun else "before cycle 0"
        if process.failed is not None:
            return f"{name} gave up: {process.failed.text}"
        if process.recorded is not None or (process.finished and process.finished.dismissed):
            how = "" if asked else "was ended by SIGTERM"
        elif exited is None or process.finished or (asked and exited.status == -signal.SIGTERM):
            how = ""  # If it was asked, it had hardly begun.
        else:
            code = exited.status
            how = f"was killed by signal {-code}" if code < 0 else f"ended ({code})"
        return f"{name} (process {process.pid}) {how} {when}" if how else ""

    def _give_up(self, process: Process, why: str) -> None:
        """Go on without a process.

        Raises FailureError: the run cannot. In lockstep the others wait for it, unless the plant
            tells them not to.
        """
        name = process.name
        is_told = PLANT in self or not self._plan.timing.lockstep
        if not self.has_begun or not (is_told or process.kind == "recorder"):
            raise self.failure(name, why)
        self.given_up[name] = self.newest_cycle
        process.become("given up")
        times = f" after {len(process.starts_s)} restarts" if process.starts_s else ""
        self._say(f"{why}; it is given up{times}: the run goes on without {name}")
        self.table.give_up(name)

    def _start(self, process: Process) -> None:
        if process.state == "ended":
            process.begin_again()
            process.become("starting")
            if process.kind == "recorder" and not self.has_begun:  # Nothing is recorded yet.
                self._folder.remove_recording()
        self._hang_up(process)
        plan, logs, earlier = self._folder.plan, self._folder.logs, len(process.starts_s)
        self.ask(Start(str(plan), str(logs), process.name, earlier, again=self.has_begun))

    def _hang_up(self, process: Process) -> None:
        if process.link is not None:
            self._ready.unregister(process.link)
            process.link.close()
        process.link, process.unread = None, b""

    def _carry_out_faults(self, now_s: float) -> None:
        wall_per_s = self._plan.timing.cycle_wall_ns / self._plan.timing.cycle_ns
        done: list[tuple[str, str]] = []
        due_s = (now_s - self._begun_at_s) / wall_per_s if wall_per_s else -inf
        while self._incidents and self._incidents[0].time_s <= due_s:
            incident = self._incidents.pop(0)
            name = self._plan.wiring.process_of(incident.agent)
            if (name, incident.what) not in done:
                done.append((name, incident.what))
                self._say(f"fault: {incident.what} {name}")
                self._send(self[name], _SIGNALS[incident.what])

    def _kill(self, process: Process, why: str) -> bool:
        if not process.pid or process.was_killed or process.exited is not None:
            return False
        if not process.is_stopped():
            if self.ran_s < self._kill_at_s:
                return False
            self._kill_at_s = self.ran_s + _KILLS_APART_S
        self._say(f"{process.name} (process {process.pid}) {why}: killed")
        self._send(process, signal.SIGKILL)
        return True

    def _send(self, process: Process, number: signal.Signals) -> None:
        """Send a signal, by the fork server: no other process can have the same number there."""
        if process.pid and process.exited is None:
            process.was_killed |= number == signal.SIGKILL
            self.ask(SendSignal(process.name, int(number)))
