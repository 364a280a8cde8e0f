"""Watches whether the machine itself stands still: a process that only sleeps beside a run.

It measures how late it is woken, as `cyclictest` does.
"""

from __future__ import annotations

import os
import select
import sys
import time
from contextlib import suppress
from subprocess import PIPE
from typing import Final, NamedTuple

import msgspec

from agents.process.machine import HIGHEST_PRIORITY, die_with_parent, wake_precisely
from agents.process.side_process import SideProcess

LATE_MS: Final = 3.0
"""Woken later than this, the process counts the machine as having stood still."""

_SLEEP_NS: Final = 2_000_000


class MachineStop(NamedTuple):
    """A time in which the machine woke nobody [ns of its monotonic clock]."""

    began_ns: int
    ended_ns: int

    @property
    def length_ms(self) -> float:
        return (self.ended_ns - self.began_ns) / 1e6


class MachineWatch(SideProcess):
    """The process, from its start to the end of the context."""

    def __init__(self) -> None:
        super().__init__("agents.process.machine_watch", stdout=PIPE)

    def stops(self) -> list[MachineStop]:
        self.hang_up()
        assert self.process.stdout is not None
        return msgspec.json.decode(self.process.stdout.read() or b"[]", type=list[MachineStop])


def main() -> None:
    """Watch until the standard input ends, then print what was found."""
    die_with_parent()
    wake_precisely()
    with suppress(OSError):  # Without the right to it, a busy machine counts too.
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(HIGHEST_PRIORITY))
    stops, late_ns = [], LATE_MS * 1e6
    while True:
        due_ns = time.monotonic_ns() + _SLEEP_NS
        is_over, *_ = select.select([sys.stdin], [], [], _SLEEP_NS / 1e9)
        now_ns = time.monotonic_ns()
        if now_ns > due_ns + late_ns:
            stops.append(MachineStop(due_ns, now_ns))
        if is_over:
            break
    sys.stdout.buffer.write(msgspec.json.encode(stops))


if __name__ == "__main__":
    main()
