"""Running `heliarch` in tests: the command as a process, and what it may leave behind."""

from __future__ import annotations

import ctypes
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import set_forkserver_preload
from multiprocessing.context import ForkServerProcess
from pathlib import Path

import psutil
import pytest

import launch_scripts.launch  # noqa: F401
from bus_schemas.errors import InputError
from bus_schemas.signals import IMPP, PRODUCTION
from heliarch.cli.main import main
from recordings.read.reader import RunReader
from recordings.read.run_file import log_name

REPOSITORY = Path(__file__).parent.parent

SMALL = """\
name = "small"
title = "Four inverters in two clusters"

[time]
start = 2010-04-01T12:00:00
timezone = "Pacific/Honolulu"
duration_s = 3600
cycle_s = 1

[plant]
inverters = "small.csv"
altitude_m = 11

[irradiance]
kind = "clouds"
seed = 1

[commitment]
kind = "share-of-clear-sky"
share = 0.5

[control]
cluster_sizes = [[2, 2]]
clusters = "listed"
# Nothing that is alive is silent for so long, on any machine.
stall_timeout_s = 60

[neighbours]
history = "hindsight"
"""
INVERTERS = """\
inverter,lat,lon,rating_kw
inv01,21.31533,-158.087,500
inv02,21.31451,-158.08534,500
inv03,21.31236,-158.08463,500
inv04,21.31303,-158.08505,400
"""


def small_plant(folder: Path, *changes: tuple[str, str]) -> str:
    """Write a scenario of four inverters, with some of its text changed; return its path."""
    text = SMALL
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    folder.mkdir(exist_ok=True)
    (folder / "small.csv").write_text(INVERTERS, encoding="utf-8")
    path = folder / "small.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


class Command(ForkServerProcess):
    """`heliarch` with some words, as a process, with the methods of `subprocess.Popen`.

    It is forked from a process that has imported this module, and so what most commands need.
    """

    def __init__(
        self,
        words: Sequence[str],
        output: Path,
        errors: Path,
        environment: Mapping[str, str],
        network: str = "",
    ) -> None:
        super().__init__()
        self._network = network
        self._words, self._files = words, (Path(os.devnull), output, errors)
        self._environment = environment
        set_forkserver_preload(["running"])
        with pytest.MonkeyPatch.context() as patch:  # The server does not take over `sys.path`.
            patch.setenv("PYTHONPATH", f"{REPOSITORY}:{REPOSITORY / 'tests'}")
            self.start()

    def run(self) -> None:
        """Be the command."""
        if self._network:
            network = os.open(f"/run/netns/{self._network}", os.O_RDONLY)
            assert ctypes.CDLL(None, use_errno=True).setns(network, 0) == 0
        os.setpgid(0, 0)  # Ctrl-C at the test's own terminal is not meant for the run.
        for number, path in enumerate(self._files):
            os.dup2(os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC), number)
        os.environ.update(self._environment)
        tempfile.tempdir = None  # TMPDIR may be another now.
        sys.argv = ["heliarch", *self._words]
        main()

    returncode = ForkServerProcess.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self.join(timeout)
        assert self.exitcode is not None, "it does not end"
        return self.exitcode

    def send_signal(self, number: signal.Signals) -> None:
        os.kill(self.pid or 0, number)


class Heliarch:
    """One `heliarch` command, running, with its output so far.

    Parameters
    ----------
    folder
        Of its run; a replay has its temporary files there.
    words
        The command line.
    network
        Namespace of the network that it runs in; empty: the test's own.
    """

    def __init__(self, folder: Path, *words: str | Path, network: str = "") -> None:
        self.folder = folder
        self.output = folder.with_suffix(".out")
        self.errors = folder.with_suffix(".err")
        modules = f"{REPOSITORY}:{os.environ.get('PYTHONPATH', '')}"
        environment = {**os.environ, "PYTHONPATH": modules}
        if words[0] == "replay":
            folder.mkdir()
            environment["TMPDIR"] = str(folder)
        else:
            words = (*words, "--out", folder)
        for path in (self.output, self.errors):
            path.touch()
        self.process = Command([*map(str, words)], self.output, self.errors, environment, network)

    def wait(self) -> int:
        return self.process.wait(timeout=170)

    def interrupt(self, number: signal.Signals = signal.SIGINT) -> int:
        """End it, with Ctrl-C by default; return its exit status."""
        self.process.send_signal(number)
        return self.wait()

    def error_text(self) -> str:
        """Standard error so far."""
        return self.errors.read_text(encoding="utf-8")

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait until something has happened."""
        give_up_at = time.monotonic() + 120.0
        is_over = False
        while not condition():
            if is_over or time.monotonic() > give_up_at:
                output = self.output.read_text() + self.error_text()
                pytest.fail(f"it never came to {what}; the run said:\n{output}")
            is_over = self.process.exitcode is not None
            time.sleep(0.02)

    def until_said(self, beginning: str) -> str:
        """Wait for a line of its output; return what follows the line's beginning."""
        line = re.compile(rf"^{re.escape(beginning)}(.*)\n", re.MULTILINE)
        self.until(lambda: line.search(self.output.read_text()) is not None, repr(beginning))
        found = line.search(self.output.read_text())
        assert found is not None
        return found[1].strip()

    def until_shown(self, text: str) -> None:
        """Wait until its output has a text."""
        self.until(lambda: text in self.output.read_text(), repr(text))

    def until_running(self) -> None:
        """Wait until cycles go by."""
        self.until_shown("delivered")

    def recorded_cycles(self) -> int:
        """Cycles that can be read from the recording: none before its first flush."""
        try:
            with RunReader(self.folder) as reader:
                return sum(1 for _ in reader.messages(PRODUCTION))
        except InputError:
            return 0

    def incarnations(self, agent: str) -> set[int]:
        """The cycles in which the processes of an agent joined, by its messages on disk."""
        with RunReader(self.folder) as reader:
            return {message.incarnation for _, message in reader.messages(IMPP, nodes=agent)}

    def until_back(self, agent: str) -> None:
        """Wait until messages of an agent's second process are on disk."""
        self.until(lambda: len(self.incarnations(agent)) == 2, f"messages of a new {agent}")

    def until_recorded(self, cycles: int = 1) -> None:
        """Wait until so many cycles can be read on disk."""
        self.until(lambda: self.recorded_cycles() >= cycles, f"{cycles} cycles on disk")

    def processes(self) -> list[psutil.Process]:
        """Processes of the run that exist now, the launcher left out."""
        return [found for found in processes_of(self.folder) if found.pid != self.process.pid]

    def process_of(self, agent: str) -> psutil.Process:
        log = self.folder / "logs" / log_name(agent)
        (found,) = [process for process in self.processes() if _output_of(process.pid) == str(log)]
        return found

    def fork_server(self) -> psutil.Process:
        (found,) = [
            process for process in self.processes() if _output_of(process.pid) == str(self.output)
        ]
        return found


Start = Callable[..., Heliarch]
"""Starts a command from its words."""

Device = Callable[..., subprocess.Popen[bytes]]
"""Starts a program in the place of agents, from its path and its words."""


@contextmanager
def commands_in(folder: Path) -> Iterator[Start]:
    """Start `heliarch` commands, each with a folder of its own; nothing outlives the context.

    Fail if a command that has ended has left a process behind.
    """
    started: list[Heliarch] = []

    def start(*words: str | Path, network: str = "") -> Heliarch:
        command = Heliarch(folder / f"run{len(started)}", *words, network=network)
        started.append(command)
        return command

    try:
        yield start
        for command in started:
            if command.process.exitcode is not None:
                assert_none_left(command.folder)
    finally:
        for command in started:
            command.process.kill()
            command.process.wait()
            for process in command.processes():
                with suppress(psutil.NoSuchProcess):
                    process.kill()


def processes_of(folder: Path) -> list[psutil.Process]:
    """Processes that write into a run's folder: the launcher, the fork server and the agents.

    They are told by their standard output, which each of them keeps to its end.
    """
    outputs = (str(folder.with_suffix(".out")), f"{folder}/")
    found = []
    for pid in psutil.pids():
        if _output_of(pid).startswith(outputs):
            with suppress(psutil.NoSuchProcess):
                found.append(psutil.Process(pid))
    return found


def _output_of(pid: int) -> str:
    """Path of a process's standard output; empty if it has ended, or is not ours."""
    try:
        return str(Path(f"/proc/{pid}/fd/1").readlink())
    except OSError:
        return ""


def assert_none_left(folder: Path) -> None:
    """Fail if a process of a run outlives it. Those that are just dying get their time."""
    _, alive = psutil.wait_procs(processes_of(folder), timeout=60)
    assert not alive, f"left over: {[process.cmdline() for process in alive]}"
