"""The machine's floor, measured beside the plant and at its rate: what no controller can go below.

A bare timer loop tells how late this machine wakes a process, a bare Zenoh round trip what two
messages cost, with the session settings of the plant, both under the load that the plant makes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from contextlib import ExitStack, suppress
from typing import IO, Final, Literal

import msgspec

from agents.machine import MachineSettings
from launch_scripts.processes import environment
from launch_scripts.tcp_ports import reserved_ports
from launch_scripts.timing.cyclictest import Cyclictest
from launch_scripts.timing.distributions import Distribution, distribution, merged
from launch_scripts.timing.floor_probe import Probed, ProbeSettings

TIMER: Final = "timer"
ROUND_TRIP: Final = "Zenoh round trip"
CYCLICTEST: Final = "cyclictest"
NOT_INSTALLED: Final = "not installed (rt-tests)"

_PATIENCE_S: Final = 3.0

NOTHING_SPECIAL: Final = MachineSettings()

Role = Literal["timer", "ping", "echo"]
_ROLES: Final[tuple[Role, ...]] = ("echo", "ping", "timer")


class FloorTimes(msgspec.Struct, frozen=True):
    """A row of the floor.

    Attributes
    ----------
    name
        What was measured.
    times
        The durations, None where nothing was measured.
    note
        Why nothing was, or how many pings were lost.
    """

    name: str
    times: Distribution | None
    note: str = ""


class Floor:
    """The probes. Leaving the context ends those that are left.

    Parameters
    ----------
    run_id
        Name of the run: the probes meet in a namespace of their own beside it.
    period_ns
        Length of the plant's cycle.
    machine
        What the processes of the run take of the machine: the probes take the same.
    """

    def __init__(
        self, run_id: str, period_ns: int, machine: MachineSettings = NOTHING_SPECIAL
    ) -> None:
        self._run_id = run_id
        self._period_ns = period_ns
        self._machine = machine
        self._cyclictest = Cyclictest(period_ns, machine)
        self._probes: dict[Role, subprocess.Popen[bytes]] = {}
        self._complaints: dict[Role, IO[bytes]] = {}
        self._resources = ExitStack()
        self._begun = False

    def __enter__(self) -> Floor:
        try:
            self._resources.callback(self._cyclictest.end)
            tcp_port = self._resources.enter_context(reserved_ports(["echo"]))["echo"]
            for role in _ROLES:
                self._start(role, tcp_port)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._end()

    def begin(self, duration_s: float) -> None:
        """Let the probes measure, for so long or until `finish`. Only the first call counts."""
        if self._begun:
            return
        self._begun = True
        for role in _ROLES:
            self._tell(role, f"begin {duration_s}")
        self._cyclictest.begin(duration_s)

    def finish(self) -> tuple[FloorTimes, ...]:
        """End the measurement and return what it came to."""
        if not self._begun:
            return ()
        cyclictest = self._cyclictest.finish()
        note = "it gave no result" if self._cyclictest.installed else NOT_INSTALLED
        rows = [self._result("timer", TIMER), self._result("ping", ROUND_TRIP)]
        found = None if cyclictest is None else distribution(cyclictest)
        return (*rows, FloorTimes(CYCLICTEST, found, "" if found else note))

    def _start(self, role: Role, tcp_port: int) -> None:
        namespace = f"floor-{self._run_id}"
        settings = ProbeSettings(role, self._period_ns, namespace, tcp_port, self._machine)
        complaints = self._resources.enter_context(
            tempfile.TemporaryFile()  # noqa: SIM115 - the stack closes it
        )
        self._complaints[role] = complaints
        self._probes[role] = subprocess.Popen(
            [
                *(sys.executable, "-P", "-m", "launch_scripts.timing.floor_probe"),
                msgspec.json.encode(settings).decode(),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=complaints,
            env=environment(),
            process_group=0,
        )

    def _tell(self, role: Role, word: str) -> None:
        stdin = self._probes[role].stdin
        if stdin is not None:
            with suppress(BrokenPipeError, ValueError):
                stdin.write(f"{word}\n".encode())
                stdin.flush()

    def _result(self, role: Role, name: str) -> FloorTimes:
        self._tell(role, "stop")
        try:
            output, _ = self._probes[role].communicate(timeout=_PATIENCE_S)
            last = output.splitlines()[-1]
            probed = msgspec.json.decode(last, type=Probed)
        except (subprocess.TimeoutExpired, IndexError, msgspec.DecodeError):
            return FloorTimes(name, None, f"not measured: {self._complaint(role)}")
        lost = f"{probed.lost} lost" if probed.lost else ""
        return FloorTimes(name, distribution(merged([probed.histogram]), probed.extremes), lost)

    def _complaint(self, role: Role) -> str:
        """Return the last line that a probe wrote of its troubles."""
        complaints = self._complaints[role]
        complaints.seek(0, os.SEEK_SET)
        lines = complaints.read().decode(errors="replace").splitlines()
        return lines[-1] if lines else "no answer"

    def _end(self) -> None:
        for probe in self._probes.values():
            probe.kill()
            for pipe in (probe.stdin, probe.stdout):
                if pipe is not None:
                    with suppress(BrokenPipeError):
                        pipe.close()
            probe.wait()
        self._resources.close()
