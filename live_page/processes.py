"""What the processes of a run take of this machine, while it goes on."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeAlias

import psutil

from recordings.read.run_file import log_name

Column: TypeAlias = list[float | None]

_COLUMNS: Final = ("cpu", "memory_mb", "pid")


class RunProcesses:
    """The processes of a run on this machine, recognised by the log that each writes."""

    def __init__(self, folder: Path, agents: Sequence[str]) -> None:
        logs = folder.resolve() / "logs"
        self._agents = {str(logs / log_name(agent)): agent for agent in agents}
        self._found: dict[str, psutil.Process] = {}

    def use(self) -> dict[str, Column]:
        """Return what each process uses; None: it is not on this machine.

        `cpu`: processor time since the last call [% of a core]. `memory_mb`: resident, with the
        pages of Python and its libraries that it shares with the others.
        """
        rows = [self._row(agent) for agent in self._agents.values()]
        if len(self._found) < len(self._agents):
            self._find()  # For the next call, which measures from now on.
        return {name: [row[place] for row in rows] for place, name in enumerate(_COLUMNS)}

    def _row(self, agent: str) -> tuple[float | None, float | None, int | None]:
        try:
            process = self._found[agent]
            return process.cpu_percent(), process.memory_info().rss / 1e6, process.pid
        except (KeyError, psutil.Error):
            self._found.pop(agent, None)
            return None, None, None

    def _find(self) -> None:
        for pid in psutil.pids():
            with suppress(OSError, psutil.Error):
                log = str(Path(f"/proc/{pid}/fd/1").readlink())
                if (agent := self._agents.get(log)) is not None and agent not in self._found:
                    self._found[agent] = process = psutil.Process(pid)
                    process.cpu_percent()
