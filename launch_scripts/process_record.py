"""The launcher's record of one process."""

from __future__ import annotations

import socket
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Final, Literal, TypeAlias

import psutil

from agents.cycle import Kind
from agents.process.beats import NO_BEAT, Beat
from agents.process.events import Exited, Failed, Finished, Recorded, Waiting

State: TypeAlias = Literal["starting", "armed", "running", "ended", "given up"]

_NEXT: Final[dict[State, tuple[State, ...]]] = {
    "starting": ("armed", "running", "ended"),
    "armed": ("running", "ended"),
    "running": ("ended",),
    "ended": ("starting", "given up"),
    "given up": (),
}
"""`armed` is a process on the bus before cycle 0, `running` one in the run."""


@dataclass(eq=False)
class Process:
    """One process of a run, or an external agent. Times are by its owner's `ran_s`.

    waiting, finished, recorded, failed, exited: The newest event of each kind.
    begins_at_s: When it is to be started again, monotonic [s]; inf: it is not.
    starts_s: When it was started again, monotonic [s].
    beat_at_s, moved_at_s: When its newest beat, and the cycle in it, were first seen.
    gone_at_s: When an external agent disappeared without which the run cannot go on.
    """

    name: str
    kind: Kind
    log: Path
    is_external: bool = False
    state: State = "starting"
    pid: int = 0
    link: socket.socket | None = None
    unread: bytes = b""
    waiting: Waiting | None = None
    finished: Finished | None = None
    recorded: Recorded | None = None
    failed: Failed | None = None
    exited: Exited | None = None
    asked_to_end: bool = False
    was_killed: bool = False
    stays_away: bool = False
    begins_at_s: float = inf
    starts_s: list[float] = field(default_factory=list)
    beat: Beat = NO_BEAT
    beat_at_s: float = 0.0
    moved_at_s: float = 0.0
    unheard_since_s: float | None = None
    unheard_in_a_row: int = 0
    gone_at_s: float = inf
    cpu_before_s: float | None = None

    def become(self, state: State) -> None:
        if state not in _NEXT[self.state]:
            raise ValueError(f"{self.name}: {self.state} and then {state}")
        self.state = state

    @property
    def is_there(self) -> bool:
        return self.state in {"armed", "running"}

    @property
    def is_through(self) -> bool:
        return bool(self.finished or self.recorded or self.exited)

    def begin_again(self) -> None:
        """Forget the process that has ended, but not its processor time."""
        self.cpu_before_s = -(self.cpu_in_run_s() or 0.0)
        self.pid = 0
        self.waiting = self.finished = self.recorded = self.failed = self.exited = None
        self.was_killed = False

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
        if cpu_s is None or self.cpu_before_s is None:
            return None
        return cpu_s - self.cpu_before_s

    def is_stopped(self) -> bool:
        try:
            return bool(psutil.Process(self.pid).status() == psutil.STATUS_STOPPED)
        except psutil.Error:
            return False


def has_exited(process: Process) -> bool:
    return process.exited is not None


def is_through(process: Process) -> bool:
    return process.is_through
