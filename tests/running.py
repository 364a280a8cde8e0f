"""Running `heliarch` in tests: the command as a process, and what it may leave behind."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest


class Heliarch:
    """One `heliarch` command, running, with its output so far."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.folder = folder
        self.output = folder.with_suffix(".out")
        self.errors = folder.with_suffix(".err")
        with self.output.open("wb") as out, self.errors.open("wb") as err:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "launch_scripts", *words, "--out", str(folder)],
                stdout=out,
                stderr=err,
                # Ctrl-C at the test's own terminal is not meant for the run.
                process_group=0,
            )

    def wait(self) -> int:
        """Wait for the end; return the exit status."""
        return self.process.wait(timeout=120)

    def error_text(self) -> str:
        """Standard error so far."""
        return self.errors.read_text(encoding="utf-8")

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait until something has happened."""
        give_up_at = time.monotonic() + 60.0
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
    _, alive = psutil.wait_procs(processes_of(folder), timeout=20)
    assert not alive, f"left over: {[process.cmdline() for process in alive]}"
