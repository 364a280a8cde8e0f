"""The launcher's end of its processes: starts them, hears them, ends them, finds out what broke."""

from __future__ import annotations

import os
import selectors
import subprocess
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import psutil

from agents.events import AnyEvent, Failed, Finished, Joined, Recorded, Waiting
from bus_schemas.tree import RECORDER
from launch_scripts.processes import ProcessSpec, environment

_LOG_LINES: Final = 5
"""Lines of a log that are shown when its process is to blame."""

_SAMPLE_S: Final = 0.5
"""Time between two looks at the memory of a process, once all have been looked at."""

_decoder = msgspec.json.Decoder(AnyEvent)


class Memory(NamedTuple):
    """Memory of a process [MB of 1,000,000 bytes]: resident in all, and its own.

    The difference is shared with the other processes: the pages of Python and of its libraries.
    """

    resident_mb: float
    own_mb: float


def memory_of(pid: int) -> Memory:
    """Return the memory of a process.

    Raises
    ------
    psutil.Error
        It has ended.
    """
    info = psutil.Process(pid).memory_full_info()
    return Memory(info.rss / 1e6, info.uss / 1e6)


class RunFailure(Exception):  # noqa: N818 - what failed is the run, not the program
    """A run that could not go on. The text names the process, who waited for what, and its log."""


@dataclass
class Child:
    """One running process.

    Attributes
    ----------
    finished
        Its account at the end; None while it runs.
    waiting
        What it last said it waited for.
    """

    spec: ProcessSpec
    process: subprocess.Popen[bytes]
    log: Path
    ready: bool = False
    finished: Finished | None = None
    recorded: Recorded | None = None
    waiting: Waiting | None = None
    failed: Failed | None = None
    closed: bool = False
    memory: Memory = field(default_factory=lambda: Memory(0.0, 0.0))
    _pending: bytes = field(default=b"", repr=False)

    def feed(self, chunk: bytes) -> list[AnyEvent]:
        """Take in bytes of its standard output; return the events that are complete."""
        *lines, self._pending = (self._pending + chunk).split(b"\n")
        events = []
        for line in lines:
            with suppress(msgspec.DecodeError):  # A library may print to standard output too.
                events.append(_decoder.decode(line))
        return events

    def tell(self, word: str) -> None:
        """Send a word."""
        if self.process.stdin is not None:
            with suppress(BrokenPipeError):
                self.process.stdin.write(f"{word}\n".encode())
                self.process.stdin.flush()

    def cpu_s(self) -> float | None:
        """Return the processor time of all its threads so far; None once it has ended."""
        try:
            times = psutil.Process(self.process.pid).cpu_times()
        except psutil.Error:
            return None
        return float(times.user + times.system)

    def last_log_lines(self) -> str:
        """Return the end of its log, empty if it said nothing."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
        return "\n".join(f"  | {line}" for line in lines[-_LOG_LINES:])


class Children:
    """All processes of a run. Leaving the context ends those that are left.

    Parameters
    ----------
    specs
        What to start.
    logs
        Folder of the log files.
    """

    def __init__(self, specs: Sequence[ProcessSpec], logs: Path) -> None:
        self.by_agent: dict[str, Child] = {}
        self._selector = selectors.DefaultSelector()
        self._specs = specs
        self._logs = logs
        self._samples = 0
        self._sample_at = 0.0

    def __enter__(self) -> Children:
        try:
            for spec in self._specs:
                self._start(spec)
        except BaseException:
            self.end()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self.end()

    def __getitem__(self, agent: str) -> Child:
        return self.by_agent[agent]

    def __iter__(self) -> Iterator[Child]:
        return iter(self.by_agent.values())

    def events(self, timeout_s: float) -> list[tuple[Child, AnyEvent]]:
        """Return what the processes say within a time; note what they report of themselves.

        Raises
        ------
        RunFailure
            A process gave up, or ended before its time.
        """
        heard: list[tuple[Child, AnyEvent]] = []
        for key, _ in self._selector.select(timeout_s):
            child: Child = key.data
            chunk = os.read(key.fd, 1 << 20)
            if not chunk:
                self._selector.unregister(key.fileobj)
                child.closed = True
            for event in child.feed(chunk):
                self._note(child, event)
                heard.append((child, event))
        self._sample_memory()
        self._check()
        return heard

    def controllers(self) -> list[Child]:
        """Return all but the recorder."""
        return [child for child in self if child.spec.agent != RECORDER]

    def await_exit(self, children: list[Child], timeout_s: float) -> list[Child]:
        """Wait for processes to end; return those that have not."""
        until = time.monotonic() + timeout_s
        left = children
        while left and time.monotonic() < until:
            self.events(0.02)
            left = [child for child in left if child.process.poll() is None]
        return left

    def end(self) -> None:
        """End every process: the recorder in order, so that its file is whole, the others at once.

        Only processes that this launcher started are touched, each by its own handle.
        """
        controllers = self.controllers()
        for child in controllers:
            if child.process.poll() is None:
                child.process.kill()
        for child in controllers:
            child.process.wait()
        recorder = self.by_agent.get(RECORDER)
        if recorder is not None:
            _end_recorder(recorder)
        for child in self:
            for pipe in (child.process.stdin, child.process.stdout):
                if pipe is not None:
                    with suppress(BrokenPipeError):
                        pipe.close()
        self._selector.close()

    def _start(self, spec: ProcessSpec) -> None:
        log = self._logs / spec.log_name
        with log.open("wb") as log_file:
            process = subprocess.Popen(
                spec.command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log_file,
                env=environment(),
                # A group of its own: Ctrl-C in the terminal is for the launcher alone.
                process_group=0,
            )
        child = Child(spec, process, log)
        self.by_agent[spec.agent] = child
        assert process.stdout is not None
        self._selector.register(process.stdout, selectors.EVENT_READ, child)

    def _note(self, child: Child, event: AnyEvent) -> None:
        match event:
            case Joined():
                child.ready = True
            case Finished():
                child.finished = event
            case Recorded():
                child.recorded = event
            case Waiting():
                child.waiting = event
            case Failed():
                child.failed = event

    def _sample_memory(self) -> None:
        """Look at the memory of one process, each in its turn.

        The kernel walks through all pages of a process for it, a millisecond in which that process
        may have to wait: once everybody has been seen, that is done rarely.
        """
        children = list(self)
        now = time.monotonic()
        if not children or now < self._sample_at:
            return
        child = children[self._samples % len(children)]
        self._samples += 1
        self._sample_at = now + (_SAMPLE_S if self._samples >= len(children) else 0.0)
        with suppress(psutil.Error):
            child.memory = max(child.memory, memory_of(child.process.pid))

    def _check(self) -> None:
        for child in self:
            if child.failed is not None:
                raise RunFailure(
                    with_log(child, f"{child.spec.agent} gave up: {child.failed.text}")
                )
            done = child.finished is not None or child.recorded is not None
            if child.closed and not done:
                raise RunFailure(self._obituary(child))

    def _obituary(self, child: Child) -> str:
        with suppress(subprocess.TimeoutExpired):
            child.process.wait(timeout=1.0)
        code = child.process.returncode
        how = (
            f"was killed by signal {-code}" if code is not None and code < 0 else f"ended ({code})"
        )
        who = f"{child.spec.agent} (process {child.process.pid})"
        return with_log(child, f"{who} {how} in the middle of the run")


def with_log(child: Child, text: str) -> str:
    """Return a text with the last log lines of the process that it is about."""
    lines = child.last_log_lines()
    return f"{text}; last lines of {child.log}:\n{lines}" if lines else text


def blame(children: Children, agent: str, text: str) -> str:
    """Return a text about an agent, with its last log lines if it is a process of this run."""
    if agent in children.by_agent:
        return with_log(children[agent], text)
    return f"{text} ({agent} is external)"


def explain_stall(children: Children) -> str:
    """Say who is waited for and does not answer, and who waits for which message.

    Those that everybody waits for and that wait for nobody themselves are to blame.
    """
    waiting = {child.spec.agent: child.waiting for child in children if child.waiting is not None}
    needed: dict[str, list[str]] = {}
    for agent, event in waiting.items():
        for port, publisher in event.needs:
            needed.setdefault(publisher, []).append(f"{agent} waits for {port}")
        if event.blocked_on:
            needed.setdefault("", []).append(f"{agent} cannot publish {event.blocked_on}")
    culprits = [agent for agent in needed if agent and agent not in waiting] or list(needed)
    cycle = max(event.cycle for event in waiting.values())
    lines = [f"stalled in cycle {cycle}: nothing more came from {', '.join(culprits) or 'the bus'}"]
    for agent in culprits:
        reasons = Counter(needed[agent])
        lines += [f"  {reason}" for reason in list(reasons)[:4]]
        if agent:
            lines[-1] = blame(children, agent, lines[-1])
    return "\n".join(lines)


def _end_recorder(recorder: Child) -> None:
    if recorder.process.poll() is not None:
        return
    if recorder.process.stdin is not None:
        with suppress(BrokenPipeError):
            recorder.process.stdin.close()
        recorder.process.stdin = None
    try:
        # It drains what is still on its way and writes its index.
        recorder.process.communicate(timeout=2.0)
    except subprocess.TimeoutExpired:
        recorder.process.kill()
        recorder.process.wait()
