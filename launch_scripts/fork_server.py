"""The fork server: one process that has imported everything starts all processes of a run by fork.

It has neither threads nor a session, so a fork copies nothing that a child could not use. Requests
come in through one socket that keeps packets apart, with the socket of each process that it is to
start. `python -m launch_scripts.fork_server SOCKET BEATS`

No process outlives the launcher: the kernel ends the server with it, and with the server the agents
at once, and the recorder as soon as it has closed its file.
"""

from __future__ import annotations

import gc
import logging
import os
import select
import shutil
import signal
import socket
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Final, NoReturn

import msgspec

from agents.loop import Loop
from agents.plan import RunPlan
from agents.plan_file import load_plan
from agents.process.beats import BEAT_S, FORK_SERVER, BeatTable
from agents.process.events import Event, Exited, Failed, Request, SendSignal, Start, Started
from agents.process.launcher_link import LauncherLink
from agents.process.machine import die_with_parent, take_files
from agents.process.session import session_settings
from agents.team import controller
from bus_schemas.tree import OPERATOR, RECORDER
from launch_scripts.process import run_process
from recordings.read.run_file import log_name

_LARGEST: Final = 1 << 20
_LAST_WAIT_S: Final = 5.0
"""How long the recorder may take to close its file when the launcher has hung up."""

_decoder = msgspec.json.Decoder(Request)


class ForkServer:
    """The server, at its end of the socket. `beats` is the descriptor of a `BeatTable`.

    The plan is read once: what becomes of its file later does not matter.
    """

    def __init__(self, control: socket.socket, beats: int) -> None:
        self._control = control
        self._beats = beats
        self._run: tuple[RunPlan, BeatTable] | None = None
        self._pids: dict[int, str] = {}
        self._starts: Counter[str] = Counter()
        self._pid = os.getpid()
        self._ended, self._wake = os.pipe()
        os.set_blocking(self._wake, False)
        os.set_blocking(self._ended, False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal is for the launcher.
        signal.set_wakeup_fd(self._wake)

    def serve(self) -> None:
        poll = select.poll()
        poll.register(self._control, select.POLLIN)
        poll.register(self._ended, select.POLLIN)
        while True:
            for fd, _ in poll.poll(BEAT_S * 1e3):
                if fd == self._ended:
                    with suppress(BlockingIOError):
                        os.read(self._ended, 4096)
                    self._reap()
                elif not self._do_next():
                    return
            if self._run is not None:
                self._run[1].beat(FORK_SERVER)

    def end(self) -> None:
        """End what is left: the recorder in order, since its file must be whole, others at once."""
        for pid, agent in self._pids.items():
            os.kill(pid, signal.SIGTERM if agent == RECORDER else signal.SIGKILL)
        until = time.monotonic() + _LAST_WAIT_S
        while self._pids and time.monotonic() < until:
            self._reap()
            time.sleep(0.01)
        for pid in self._pids:
            os.kill(pid, signal.SIGKILL)
        if self._run is not None and self._run[0].access.sockets:  # The launcher may be dead.
            shutil.rmtree(self._run[0].access.sockets, ignore_errors=True)

    def _do_next(self) -> bool:
        """Do what the launcher asks next; return False if it is gone."""
        try:
            packet, sockets, *_ = socket.recv_fds(self._control, _LARGEST, 1)
        except ConnectionResetError:  # The launcher has gone before it has read everything.
            return False
        if not packet:
            return False
        match _decoder.decode(packet):
            case Start() as request:
                self._fork(request, sockets[0])
            case SendSignal() as request:
                for pid, agent in self._pids.items():
                    if agent == request.agent:
                        os.kill(pid, request.number)
        return True

    def _run_of(self, request: Start) -> tuple[RunPlan, BeatTable]:
        """Return the plan of the run, and what all processes need, worked out once."""
        if self._run is None:
            plan = load_plan(Path(request.plan))
            take_files(len(plan.processes))
            self._run = plan, BeatTable(self._beats, plan.processes)
            own = [process for process in plan.processes if process != OPERATOR]
            for process in own[-1:]:
                for name in plan.wiring.members[process]:
                    Loop(controller(plan, name), plan)
                session_settings(plan, process)
            gc.collect()
            gc.freeze()
        return self._run

    def _fork(self, request: Start, link: int) -> None:
        plan, table = self._run_of(request)
        pid = os.fork()
        if pid == 0:
            self._become(request, plan, table, socket.socket(fileno=link))
        os.close(link)
        self._pids[pid] = request.agent
        self._starts[request.agent] += 1
        self._tell(Started(request.agent, pid))

    def _become(
        self, request: Start, plan: RunPlan, table: BeatTable, events: socket.socket
    ) -> NoReturn:
        status, agent = 1, request.agent
        try:
            self._set_up(agent, Path(request.logs) / log_name(agent))
            link = LauncherLink(agent, events, table, self._starts[agent])
            link.end_on(signal.SIGTERM)
            table.sends(agent)[0] = False
            link.beat(-1)
            status = run_process(
                agent, plan, link, Path(request.plan).parent, rejoins=request.again
            )
        except BaseException:
            logging.exception("%s gives up", agent)
        finally:
            logging.shutdown()
            os._exit(status)

    def _set_up(self, agent: str, log: Path) -> None:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        os.setpgid(0, 0)
        die_with_parent(signal.SIGTERM if agent == RECORDER else signal.SIGKILL)
        if os.getppid() != self._pid:  # The server has died in the meantime.
            os._exit(1)
        os.close(self._ended)
        os.close(self._wake)
        self._control.close()
        try:
            log_file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        except OSError:  # The run's folder has been removed.
            log_file = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(log_file, stream)
        os.close(log_file)
        with suppress(OSError):  # The name that `top` and `ps` show.
            Path("/proc/self/comm").write_text(agent[-15:], encoding="ascii")
        logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)

    def _reap(self) -> None:
        while self._pids:
            pid, status, usage = os.wait4(-1, os.WNOHANG)
            if pid == 0:
                return
            cpu_s, resident_mb = usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1.024e-3
            code = os.waitstatus_to_exitcode(status)
            self._tell(Exited(self._pids.pop(pid), code, cpu_s, resident_mb))

    def fail(self, error: Exception) -> None:
        with suppress(OSError):
            self._tell(Failed(f"{type(error).__name__}: {error}"))

    def _tell(self, event: Event) -> None:
        with suppress(BrokenPipeError, ConnectionResetError):
            self._control.send(msgspec.json.encode(event))


def main() -> None:
    die_with_parent()
    control, beats = socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2])
    server = ForkServer(control, beats)
    try:
        server.serve()
    except ConnectionResetError:
        pass  # The launcher is gone, and left events unread.
    except Exception as error:
        server.fail(error)
        raise
    finally:
        server.end()


if __name__ == "__main__":
    main()
