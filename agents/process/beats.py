"""Signs of life: memory that the processes of a run share with their launcher.

A beat needs no bus and cannot get lost. In the same memory the launcher says who was given up, how
many messages the recorder is to expect, and when all is recorded.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Sequence
from mmap import mmap
from typing import Final, NamedTuple

from bus_schemas.host_clock import CLOCK_BYTES

BEAT_S: Final = 0.8
"""No process waits longer than this without a beat."""

FORK_SERVER: Final = "fork server"
"""It beats too, in the first place of the table."""

_HEAD: Final = struct.Struct("qq?7x")
"""Messages to expect, counted from 1 (0: not known), how many agents were given up, and whether the
recording is closed."""

_PLACE: Final = struct.Struct("qq???5x")
_SENDS: Final = 16
_GIVEN_UP: Final = 17
_DISMISSED: Final = 18


class Beat(NamedTuple):
    """The newest beat of a process.

    time_ns: Its monotonic time; 0: there was none.
    sends: Whether the process is sending a message, for which it may have to wait in lockstep.
    """

    time_ns: int
    cycle: int
    sends: bool
    is_given_up: bool
    is_dismissed: bool


NO_BEAT: Final = Beat(0, -1, sends=False, is_given_up=False, is_dismissed=False)


class BeatTable:
    """A place for each process. `file`: Descriptor of memory without a name."""

    def __init__(self, file: int, processes: Sequence[str]) -> None:
        names = (FORK_SERVER, *processes)
        self._clock = _HEAD.size + len(names) * _PLACE.size
        size = self._clock + CLOCK_BYTES
        if os.fstat(file).st_size < size:
            os.ftruncate(file, size)
        self._memory = mmap(file, size)
        self._places = {name: _HEAD.size + n * _PLACE.size for n, name in enumerate(names)}

    def beat(self, name: str, cycle: int = -1) -> None:
        now_ns = time.monotonic_ns()
        struct.pack_into("qq", self._memory, self._places[name], now_ns, cycle)

    def sends(self, name: str) -> memoryview:
        place = self._places[name] + _SENDS
        return memoryview(self._memory)[place : place + 1]

    def clock(self) -> memoryview:
        """Return the memory of the clock of another host, which all its processes share."""
        return memoryview(self._memory)[self._clock : self._clock + CLOCK_BYTES].cast("q")

    def read(self, name: str) -> Beat:
        return Beat._make(_PLACE.unpack_from(self._memory, self._places[name]))

    def dismiss(self, name: str) -> None:
        self._memory[self._places[name] + _DISMISSED] = True

    def is_dismissed(self, name: str) -> bool:
        return bool(self._memory[self._places[name] + _DISMISSED])

    def give_up(self, name: str) -> None:
        self._memory[self._places[name] + _GIVEN_UP] = True
        expected, number, is_closed = _HEAD.unpack_from(self._memory)
        _HEAD.pack_into(self._memory, 0, expected, number + 1, is_closed)

    @property
    def number_given_up(self) -> int:
        return int(_HEAD.unpack_from(self._memory)[1])

    def given_up(self) -> tuple[str, ...]:
        return tuple(name for name in self._places if self.read(name).is_given_up)

    def expect(self, messages: int) -> None:
        """Let the recorder end once this number of messages of the run has come."""
        _HEAD.pack_into(self._memory, 0, messages + 1, self.number_given_up, False)

    def expected(self) -> int | None:
        count, *_ = _HEAD.unpack_from(self._memory)
        return int(count) - 1 if count else None

    def close_recording(self) -> None:
        """Let processes that are through leave the bus."""
        _HEAD.pack_into(self._memory, 0, 0, self.number_given_up, True)

    @property
    def recording_is_closed(self) -> bool:
        return bool(_HEAD.unpack_from(self._memory)[2])
