"""The machine's floor, measured beside the plant and at its rate: what no controller can go below.

A bare timer loop tells how late this machine wakes a process, a bare Zenoh round trip what two
messages cost, with the session settings of the plant, both under the load that the plant makes.
"""

from __future__ import annotations

import subprocess
import sys
from contextlib import ExitStack, suppress
from typing import Final, TypeAlias

import msgspec

from agents.machine import MachineSettings
from launch_scripts.launcher.tcp_ports import reserved_ports
from studies.timing.durations import Distribution
from studies.timing.floor_probe import Probed, ProbeSettings

_PATIENCE_S: Final = 3.0

_ROLES: Final = {"timer": "timer", "ping": "Zenoh round trip"}
"""Probes that measure, and what they are called. `echo` answers the pings."""

_Probe: TypeAlias = subprocess.Popen[bytes]


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

    def __init__(self, run_id: str, period_ns: int, machine: MachineSettings) -> None:
        self._settings = ProbeSettings("timer", period_ns, f"floor-{run_id}", 0, machine)
        self._resources = ExitStack()
        self._probes: dict[str, _Probe] = {}
        self._begun = False

    def __enter__(self) -> Floor:
        with ExitStack() as stack:
            port = stack.enter_context(reserved_ports(["echo"]))["echo"]
            for role in ("echo", *_ROLES):
                settings = msgspec.structs.replace(self._settings, role=role, tcp_port=port)
                self._probes[role] = stack.enter_context(_started(settings))
                stack.callback(self._probes[role].kill)
            self._resources = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._resources.close()

    def begin(self, duration_s: float) -> None:
        """Let the probes measure, for so long or until `finish`."""
        self._begun = True
        for role in _ROLES:
            self._tell(role, f"begin {duration_s}")

    def finish(self) -> tuple[FloorTimes, ...]:
        """End the measurement and return what it came to."""
        if not self._begun:
            return ()
        return tuple(self._result(role, name) for role, name in _ROLES.items())

    def _tell(self, role: str, word: str) -> None:
        stdin = self._probes[role].stdin
        assert stdin is not None
        with suppress(BrokenPipeError):
            stdin.write(f"{word}\n".encode())
            stdin.flush()

    def _result(self, role: str, name: str) -> FloorTimes:
        self._tell(role, "stop")
        complaint = b""
        try:
            output, complaint = self._probes[role].communicate(timeout=_PATIENCE_S)
            probed = msgspec.json.decode(output, type=Probed)
        except (subprocess.TimeoutExpired, msgspec.DecodeError):
            last = complaint.decode(errors="replace").splitlines()[-1:] or ["no answer"]
            return FloorTimes(name, None, f"not measured: {last[0]}")
        note = "" if probed.times else "nothing was measured"
        return FloorTimes(name, probed.times, f"{probed.lost} lost" if probed.lost else note)


def _started(settings: ProbeSettings) -> _Probe:
    """Start a probe. It dies with this process; Ctrl-C in a terminal does not reach it."""
    words = ("-P", "-m", "studies.timing.floor_probe")
    return subprocess.Popen(
        [sys.executable, *words, msgspec.json.encode(settings).decode()],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        process_group=0,
    )
