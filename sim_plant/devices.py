"""Real inverters: the plant's process and the gateway exchange readings and commands.

Two named pipes in the run's folder carry records of a fixed size. Nobody ever waits at a pipe: what
does not fit into a full one is dropped, and the reader takes the newest record of each inverter.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from math import isnan, nan
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Command

_RECORD: Final = struct.Struct("<qqddd")
"""Place of the inverter in the control tree, a monotonic time [ns], and three numbers."""

_PIPES: Final = ("device-readings", "device-commands")

_FRESH_CYCLES: Final = 2.5
"""A reading that is older than this is no telemetry."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What an inverter says of itself, at a monotonic time.

    It may not say what it could give. The limit is the one in force, or its rating.
    """

    time_ns: int
    power_kw: float
    available_kw: float | None
    limit_kw: float


def parse_address(address: str, where: str) -> tuple[str, int, int]:
    """Return host, port and unit of an address such as `modbus://10.0.0.7:502/1`."""
    with suppress(ValueError):
        parts = urlsplit(address)
        unit = int(parts.path.strip("/") or 1)
        port = 502 if parts.port is None else parts.port
        if parts.scheme == "modbus" and parts.hostname and port and 1 <= unit <= 247:
            return parts.hostname, port, unit
    expected = "an address such as modbus://10.0.0.7:502/1 (host, port, unit 1 to 247)"
    raise InputError(f"{where}: expected {expected}, got {address}")


class Pipes:
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

    def hand_reading(self, place: int, reading: Reading) -> None:
        available_kw = nan if reading.available_kw is None else reading.available_kw
        numbers = reading.power_kw, available_kw, reading.limit_kw
        _write(self._readings, place, reading.time_ns, *numbers)

    def take_commands(self) -> Iterator[tuple[int, float, float | None]]:
        """Yield place, limit and limit after the revert time of commands that have come [kW]."""
        for place, _, limit_kw, revert_kw, _ in _records(self.commands):
            yield place, limit_kw, None if isnan(revert_kw) else revert_kw


class Devices:
    """The real inverters of a run, by their places in the control tree, with newest readings."""

    def __init__(self, plan: RunPlan, folder: Path) -> None:
        self.places = [plan.tree.leaves.index(node) for node, _ in plan.devices]
        self.newest: dict[int, Reading] = {}
        self._oldest_ns = round(_FRESH_CYCLES * plan.cycle_wall_ns)
        self._handed = dict.fromkeys(self.places, -1)
        readings, commands = (folder / name for name in _PIPES)
        self._readings = os.open(readings, os.O_RDONLY | os.O_NONBLOCK)
        self._commands = os.open(commands, os.O_WRONLY | os.O_NONBLOCK)
        for path in (readings, commands):  # Nobody else comes, and whoever reads a folder waits.
            path.unlink()

    def read(self) -> None:
        for place, time_ns, power_kw, available_kw, limit_kw in _records(self._readings):
            available = None if isnan(available_kw) else available_kw
            self.newest[place] = Reading(time_ns, power_kw, available, limit_kw)

    def silent(self, cycle: int) -> set[int]:
        """Return the places of inverters that have said nothing for too long."""
        oldest_ns = time.monotonic_ns() - self._oldest_ns if cycle >= 0 else 0
        return {place for place, found in self.newest.items() if found.time_ns < oldest_ns}

    def command(self, place: int, command: Command) -> None:
        """Hand a command over, unless that was done already."""
        if command.cycle > self._handed[place]:
            self._handed[place] = command.cycle
            revert_kw = nan if command.revert_kw is None else command.revert_kw
            _write(self._commands, place, time.monotonic_ns(), command.power_kw, revert_kw, 0.0)


def _write(pipe: int, *record: float) -> None:
    with suppress(BlockingIOError, BrokenPipeError):  # The gateway's end is the launcher's matter.
        os.write(pipe, _RECORD.pack(*record))


def _records(pipe: int) -> Iterator[tuple[int, int, float, float, float]]:
    with suppress(BlockingIOError):
        while found := os.read(pipe, 1_000 * _RECORD.size):
            yield from _RECORD.iter_unpack(found)
