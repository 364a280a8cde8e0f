"""What the processes of a run take of this machine, while it goes on."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeAlias

import psutil

from recordings.read.run_file import log_name

Column: TypeAlias = list[float | None]

_SAMPLES: Final = 10
"""Processor time is counted in ticks of 10 ms: it takes some samples to tell it."""

_COLUMNS: Final = ("cpu", "memory_mb", "pid")


@dataclass
class _Followed:
    """A process, and when it had taken how much processor time [s]."""

    process: psutil.Process
    samples: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=_SAMPLES))

    def row(self) -> tuple[float | None, float, int]:
        with self.process.oneshot():
            now, used = time.monotonic(), sum(self.process.cpu_times()[:2])
            memory_mb = self.process.memory_info().rss / 1e6
        self.samples.append((now, used))
        began, used_before = self.samples[0]
        cpu = 100 * (used - used_before) / (now - began) if now > began else None
        return cpu, memory_mb, self.process.pid


class RunProcesses:
    """The processes of a run on this machine, told by the log that each writes."""

    def __init__(self, folder: Path, agents: Sequence[str]) -> None:
        logs = folder.resolve() / "logs"
        self._agents = {str(logs / log_name(agent)): agent for agent in agents}
        self._found: dict[str, _Followed] = {}

    def use(self) -> dict[str, Column]:
        """Return what each process takes; None for those that are not on this machine.

        `cpu`: processor time over the last samples [% of a core]. `memory_mb`: resident, with the
        pages of Python and its libraries that it shares with the others. `pid`: its number.
        """
        if len(self._found) < len(self._agents):
            self._find()
        rows = [self._row(agent) for agent in self._agents.values()]
        return {name: [row[place] for row in rows] for place, name in enumerate(_COLUMNS)}

    def _row(self, agent: str) -> tuple[float | None, float | None, int | None]:
        try:
            return self._found[agent].row()
        except (KeyError, psutil.Error):
            self._found.pop(agent, None)
            return None, None, None

    def _find(self) -> None:
        for pid in psutil.pids():
            with suppress(OSError, psutil.Error):
                log = str(Path(f"/proc/{pid}/fd/1").readlink())
                if (agent := self._agents.get(log)) is not None and agent not in self._found:
                    self._found[agent] = _Followed(psutil.Process(pid))
