"""Running `heliarch` in tests: the command as a process, and what it may leave behind."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

PATIENT_HELIARCH = Path(__file__).with_name("patient_heliarch.py")
REPOSITORY = Path(__file__).parent.parent

PATIENCE_S = 60.0
"""Nothing that is alive is silent for so long, on any machine: see `patient_heliarch`."""


class Heliarch:
    """One `heliarch` command, running, with its output so far.

    Parameters
    ----------
    folder
        Of its run.
    words
        The command line.
    stall_s, heartbeat_s
        How long it waits for a silent agent, and for a silent recorder.
    """

    def __init__(
        self,
        folder: Path,
        *words: str,
        stall_s: float = PATIENCE_S,
        heartbeat_s: float = PATIENCE_S,
    ) -> None:
        self.folder = folder
        self.output = folder.with_suffix(".out")
        self.errors = folder.with_suffix(".err")
        patience = (str(stall_s), str(heartbeat_s))
        with self.output.open("wb") as out, self.errors.open("wb") as err:
            self.process = subprocess.Popen(
                [sys.executable, PATIENT_HELIARCH, *patience, *words, "--out", str(folder)],
                stdout=out,
                stderr=err,
                env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
                # Ctrl-C at the test's own terminal is not meant for the run.
                process_group=0,
            )

    def wait(self) -> int:
        """Wait for the end; return the exit status."""
        return self.process.wait(timeout=170)

    def error_text(self) -> str:
        """Standard error so far."""
        return self.errors.read_text(encoding="utf-8")

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait until something has happened."""
        give_up_at = time.monotonic() + 120.0
        while not condition():
            if self.process.poll() is not None or time.monotonic() > give_up_at:
                output = self.output.read_text() + self.error_text()
                pytest.fail(f"it never came to {what}; the run said:\n{output}")
            time.sleep(0.02)

    def until_running(self) -> None:
        """Wait until cycles go by."""
        self.until(lambda: "desired" in self.output.read_text(), "its first cycles")

    def processes(self) -> list[psutil.Process]:
        """Processes of the run that exist now, the launcher left out."""
        return processes_of(self.folder)

    def process_of(self, agent: str) -> psutil.Process:
        """Return the process of one agent."""
        word = {"plant": "sim_plant", "recorder": "recordings"}.get(agent, agent)
        (found,) = [process for process in self.processes() if word in process.cmdline()]
        return found


@contextmanager
def commands_in(folder: Path) -> Iterator[Callable[..., Heliarch]]:
    """Start `heliarch` commands, each with a folder of its own; nothing outlives the context."""
    started: list[Heliarch] = []

    def start(*words: str, **patience: float) -> Heliarch:
        command = Heliarch(folder / f"run{len(started)}", *words, **patience)
        started.append(command)
        return command

    try:
        yield start
    finally:
        for command in started:
            command.process.kill()
            command.process.wait()
            for process in command.processes():
                process.kill()


def processes_of(folder: Path) -> list[psutil.Process]:
    """Processes whose plan is in a run's folder: told by their arguments, not by their names."""
    plan = str(folder / "plan.json")
    found = []
    for process in psutil.process_iter(["cmdline"]):
        if plan in (process.info["cmdline"] or []):
            found.append(process)
    return found


def assert_none_left(folder: Path) -> None:
    """Fail if a process of a run outlives it. Those that are just dying get their time."""
    _, alive = psutil.wait_procs(processes_of(folder), timeout=60)
    assert not alive, f"left over: {[process.cmdline() for process in alive]}"
