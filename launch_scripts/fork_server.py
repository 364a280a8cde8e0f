"""The fork server: one process that has imported everything starts all processes of a run by fork.

It has neither threads nor a session, so a fork copies nothing that a child could not use. Requests
come in through one socket that keeps packets apart; events go out with the link to each process
that was started. `python -m launch_scripts.fork_server SOCKET BEATS`

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
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final, NoReturn

import msgspec

from agents.loop import Loop
from agents.plan import RunPlan
from agents.plan_file import load_plan
from agents.process.beats import BEAT_S, FORK_SERVER, BeatTable
from agents.process.events import Event, Exited, Failed, Request, Start, Started
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

Pids = dict[int, str]
"""The processes that run, with their names in the plan."""


def serve(control: socket.socket, beats: int) -> None:
    """Do what the launcher asks, until it hangs up; then end what is left.

    `beats` is the descriptor of a `BeatTable`.
    """
    pids: Pids = {}
    run: tuple[RunPlan, BeatTable] | None = None
    poll, ended = _poll(control)
    try:
        while True:
            for fd, _ in poll.poll(BEAT_S * 1e3):
                if fd == ended:
                    os.read(ended, 4096)
                    _reap(control, pids)
                elif packet := control.recv(_LARGEST):
                    run = _obey(_decoder.decode(packet), control, beats, pids) or run
                else:
                    return
            if run is not None:
                run[1].beat(FORK_SERVER)
    except ConnectionResetError:
        pass  # The launcher is gone, and left events unread.
    except Exception as error:
        _tell(control, Failed(f"{type(error).__name__}: {error}"))
        raise
    finally:
        _end(control, pids, run[0].access.sockets if run else "")


def _obey(
    request: Request, control: socket.socket, beats: int, pids: Pids
) -> tuple[RunPlan, BeatTable] | None:
    """Do what the launcher asks; return the run of which it is."""
    if isinstance(request, Start):
        run = _run(request.plan, beats)
        pids[_fork(request, control, *run)] = request.agent
        return run
    for pid in [pid for pid, agent in pids.items() if agent == request.agent]:
        os.kill(pid, request.number)
    return None


def _poll(control: socket.socket) -> tuple[select.poll, int]:
    """Return what waits for requests and ends of processes; the latter come on the descriptor."""
    ended, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal is for the launcher.
    signal.set_wakeup_fd(wake)
    poll = select.poll()
    poll.register(control, select.POLLIN)
    poll.register(ended, select.POLLIN)
    return poll, ended


def _end(control: socket.socket, pids: Pids, sockets: str) -> None:
    """End what is left: the recorder in order, since its file must be whole, others at once."""
    for pid, agent in pids.items():
        os.kill(pid, signal.SIGTERM if agent == RECORDER else signal.SIGKILL)
    until = time.monotonic() + _LAST_WAIT_S
    while pids and time.monotonic() < until:
        _reap(control, pids)
        time.sleep(0.01)
    for pid in pids:
        os.kill(pid, signal.SIGKILL)
    if sockets:  # The launcher may be dead.
        shutil.rmtree(sockets, ignore_errors=True)


@cache
def _run(path: str, beats: int) -> tuple[RunPlan, BeatTable]:
    """Return the plan of the run and what all processes need, worked out once.

    What becomes of the plan's file later does not matter.
    """
    plan = load_plan(Path(path))
    take_files(len(plan.processes))
    own = [process for process in plan.processes if process != OPERATOR]
    for process in own[-1:]:
        for name in plan.wiring.members[process]:
            Loop(controller(plan, name), plan)
        session_settings(plan, process)
    gc.collect()
    gc.freeze()
    return plan, BeatTable(beats, plan.processes)


def _fork(request: Start, control: socket.socket, plan: RunPlan, table: BeatTable) -> int:
    server, (ours, theirs) = os.getpid(), socket.socketpair()
    pid = os.fork()
    if pid == 0:
        ours.close()
        _become(request, control, server, plan, table, theirs)
    theirs.close()
    with ours:
        _tell(control, Started(request.agent, pid), ours)
    return pid


def _become(
    request: Start,
    control: socket.socket,
    server: int,
    plan: RunPlan,
    table: BeatTable,
    events: socket.socket,
) -> NoReturn:
    """Be the process of an agent, from the fork to the end."""
    status, agent = 1, request.agent
    try:
        os.close(signal.set_wakeup_fd(-1))
        control.close()
        _set_up(agent, server, Path(request.logs) / log_name(agent))
        link = LauncherLink(agent, events, table, request.earlier)
        link.end_on(signal.SIGTERM)
        table.sends(agent)[0] = False
        link.beat(-1)
        status = run_process(agent, plan, link, Path(request.plan).parent, rejoins=request.again)
    except BaseException:
        logging.exception("%s gives up", agent)
    finally:
        logging.shutdown()
        os._exit(status)


def _set_up(agent: str, server: int, log: Path) -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    os.setpgid(0, 0)
    die_with_parent(signal.SIGTERM if agent == RECORDER else signal.SIGKILL)
    if os.getppid() != server:  # It has died in the meantime.
        os._exit(1)
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


def _reap(control: socket.socket, pids: Pids) -> None:
    while pids:
        pid, status, usage = os.wait4(-1, os.WNOHANG)
        if pid == 0:
            return
        cpu_s, resident_mb = usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1.024e-3
        code = os.waitstatus_to_exitcode(status)
        _tell(control, Exited(pids.pop(pid), code, cpu_s, resident_mb))


def _tell(control: socket.socket, event: Event, *links: socket.socket) -> None:
    with suppress(BrokenPipeError, ConnectionResetError):
        socket.send_fds(control, [msgspec.json.encode(event)], [link.fileno() for link in links])


def main() -> None:
    die_with_parent()
    serve(socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2]))


if __name__ == "__main__":
    main()
