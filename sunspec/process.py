"""The gateway as a process of its own beside a run, and the launcher's hold on it.

The launcher writes the plan to the gateway's standard input, and later the run's folder. The
gateway answers each with an empty line when that is done; its other lines are messages for the
user. It ends when its standard input does.
"""

from __future__ import annotations

import importlib
import os
import select
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from agents.plan import RunPlan
from agents.process.side_process import SideProcess
from bus_schemas.errors import FailureError, InputError
from bus_schemas.whole_file import whole_file

_ACCOUNTS: Final = "devices.json"


class Latency(msgspec.Struct, frozen=True):
    """How long requests took."""

    count: int
    p50_ms: float
    p99_ms: float


class DeviceAccount(msgspec.Struct, frozen=True):
    """A real inverter in a run: how long it took to answer, how often it refused or was gone.

    `late` counts readings after the end of their cycle. `gone_s`: since when; None: it is there.
    `excess_kw` is the most that it gave beyond the limits that it had acknowledged.
    """

    node: str
    address: str
    reads: Latency
    writes: Latency
    late: int
    refused: int
    breaks: int
    gone_s: float | None
    excess_kw: float = 0.0

    @property
    def has_faults(self) -> bool:
        """Whether it was late, refused anything, was gone, or did not follow its limits."""
        return any((self.late, self.refused, self.breaks, self.excess_kw))


def write_accounts(folder: Path, accounts: tuple[DeviceAccount, ...]) -> None:
    """Leave the accounts so far in a run's folder."""
    with whole_file(folder / _ACCOUNTS) as file:
        file.write(msgspec.json.encode(accounts))


def read_accounts(folder: Path) -> tuple[DeviceAccount, ...]:
    """Return the accounts of the real inverters of the run in a folder; none if it had none."""
    with suppress(OSError, msgspec.DecodeError):
        document = (folder / _ACCOUNTS).read_bytes()
        return msgspec.json.decode(document, type=tuple[DeviceAccount, ...])
    return ()


def log_in(folder: Path) -> Path:
    return folder / "logs" / "gateway.log"


class PlantUnitProcess(SideProcess):
    """The process that serves the plant as one Modbus unit, beside a run."""

    def __init__(self, address: str, folder: Path) -> None:
        importlib.import_module("sunspec2")  # Or the command names the extra to install.
        words = ("sunspec.plant_unit", address, str(folder.absolute()))
        super().__init__(*words, stdout=subprocess.PIPE)
        assert self.process.stdout is not None
        refusal = os.fsdecode(self.process.stdout.readline())
        if refusal != "\n":
            self.close()
            if not refusal:  # Its traceback stands above.
                what = f"the plant's Modbus unit (process {self.process.pid})"
                raise FailureError(f"{what} ended with status {self.process.wait()} at its start")
            raise InputError(refusal.strip())


class GatewayProcess(SideProcess):
    """The gateway's process, as its launcher sees it. It ends with the context."""

    def __init__(self, plan: RunPlan) -> None:
        importlib.import_module("sunspec2")  # Or the command names the extra to install.
        super().__init__("sunspec.gateway", stdout=subprocess.PIPE)
        self._folder: Path | None = None
        try:
            self.tell(msgspec.json.encode(plan))
            if refusal := self._next_line():
                raise InputError(refusal)
        except BaseException:
            self.close()
            raise

    def join(self, folder: Path) -> None:
        """Let the plant's process find the gateway in a run's folder."""
        self._folder = folder
        self.tell(str(folder.absolute()).encode())
        self._next_line()

    def look(self, say: Callable[[str], None]) -> None:
        """Pass the gateway's messages on. Raises FailureError: It has ended."""
        assert self.process.stdout is not None
        while select.select([self.process.stdout], [], [], 0.0)[0]:
            if line := self._next_line():
                say(line)

    def end(self) -> tuple[DeviceAccount, ...]:
        """End the gateway; return what it measured."""
        assert self._folder is not None
        self.close()
        return read_accounts(self._folder)

    def _next_line(self) -> str:
        """Return the gateway's next line. Raises FailureError: It has ended."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            log = f"; its log: {log_in(self._folder)}" if self._folder else ""
            what = f"the gateway to the devices (process {self.process.pid})"
            raise FailureError(f"{what} ended with status {self.process.wait()}{log}")
        return os.fsdecode(line.rstrip(b"\n"))
