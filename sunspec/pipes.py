"""How the plant's process and the gateway exchange readings and limits of real devices.

Two named pipes in the run's folder carry records of a fixed size. Neither end waits: what
does not fit into a full one is dropped, and the reader takes the newest record of each.
"""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from math import nan
from pathlib import Path
from struct import Struct
from typing import Any, Final, NamedTuple

from agents.plan import RunPlan
from bus_schemas.messages import Command
from sim_plant.real_inverters import Reading

_PIPES: Final = ("device-readings", "device-commands")

# Each record begins with the position of the inverter or storage in the control tree.
_READING: Final = Struct("<qqdddd")
_LIMIT: Final = Struct("<qdd")

_FRESH_CYCLES: Final = 2.5
"""A reading that is older than this is no telemetry."""


class Limit(NamedTuple):
    """A limit, or a storage's power, and the one after the revert time [kW]; NaN: none."""

    kw: float
    revert_kw: float


class GatewayPipes:
    """The two named pipes, at the end of the gateway, which makes them."""

    def __init__(self, folder: Path) -> None:
        self._paths = [folder / name for name in _PIPES]
        for path in self._paths:
            os.mkfifo(path, 0o600)
        self._readings, self.commands = (
            os.open(path, os.O_RDWR | os.O_NONBLOCK) for path in self._paths
        )

    def close(self) -> None:
        """Remove the pipes if the plant has not come."""
        for path in self._paths:
            path.unlink(missing_ok=True)

    def hand_reading(self, position: int, reading: Reading) -> None:
        _write(self._readings, _READING.pack(position, *reading))

    def take_limits(self) -> Iterator[tuple[int, Limit]]:
        """Yield the limits that have come, each with the position of its inverter."""
        for position, *numbers in _records(self.commands, _LIMIT):
            yield position, Limit(*numbers)


class PlantPipes:
    """The real inverters of a run, by their positions in the control tree, for the plant."""

    def __init__(self, plan: RunPlan, folder: Path) -> None:
        self._newest: dict[int, Reading] = {}
        self._oldest_ns = round(_FRESH_CYCLES * plan.timing.cycle_wall_ns)
        self._handed: dict[int, int] = {}
        readings, commands = (folder / name for name in _PIPES)
        self._readings = os.open(readings, os.O_RDONLY | os.O_NONBLOCK)
        self._commands = os.open(commands, os.O_WRONLY | os.O_NONBLOCK)
        # No other end will open them, and a program that reads the folder would wait for one.
        for path in (readings, commands):
            path.unlink()

    def newest(self) -> Mapping[int, Reading]:
        for position, *numbers in _records(self._readings, _READING):
            self._newest[position] = Reading(*numbers)
        return self._newest

    def expired(self, cycle: int) -> Collection[int]:
        oldest_ns = time.monotonic_ns() - self._oldest_ns if cycle >= 0 else 0
        return {position for position, found in self._newest.items() if found.time_ns < oldest_ns}

    def command(self, position: int, command: Command) -> None:
        """Hand a command over, unless that was done already."""
        if command.cycle > self._handed.get(position, -1):
            self._handed[position] = command.cycle
            revert_kw = nan if command.revert_kw is None else command.revert_kw
            _write(self._commands, _LIMIT.pack(position, command.power_kw, revert_kw))


def _write(pipe: int, record: bytes) -> None:
    with suppress(BlockingIOError, BrokenPipeError):  # The gateway's end is the launcher's matter.
        os.write(pipe, record)


def _records(pipe: int, kind: Struct) -> Iterator[tuple[Any, ...]]:
    with suppress(BlockingIOError):
        while found := os.read(pipe, 1_000 * kind.size):
            yield from kind.iter_unpack(found)
