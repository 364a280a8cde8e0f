"""The device's program: started for each launch, killed and started again where one says so."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Final

from bus_schemas.errors import InputError

_END_S: Final = 10.0


class Device:
    """A program that is started by a command; without one the user starts it."""

    def __init__(self, command: str | None, node: str, folder: Path) -> None:
        self.can_restart = command is not None
        self._command = command or ""
        self._node = node
        self._log = folder / "device.log"
        self._process: subprocess.Popen[bytes] | None = None
        if command is not None and not self.words(folder):
            raise InputError(
                f"--command: expected a program that is there, with its words, got {command!r}"
            )

    def __enter__(self) -> Device:
        return self

    def __exit__(self, *error: object) -> None:
        self.end(0.0)

    def words(self, plan: Path) -> list[str]:
        """Return the command's words for a plan; none if it is no command."""
        try:
            words = [word.format(plan=plan, node=self._node) for word in shlex.split(self._command)]
        except (ValueError, KeyError, IndexError):
            return []
        return words if words and shutil.which(words[0]) else []

    def start(self, plan: Path) -> None:
        """Start it, unless it runs."""
        if self._command and (self._process is None or self.end_text):
            self._log.parent.mkdir(parents=True, exist_ok=True)
            with self._log.open("ab") as log:
                self._process = subprocess.Popen(self.words(plan), stdout=log, stderr=log)

    @property
    def end_text(self) -> str:
        """How its program has ended, and where its last words are; empty if it runs."""
        if self._process is None or self._process.poll() is None:
            return ""
        return f"its program has ended with status {self._process.returncode}, see {self._log}"

    def end(self, patience_s: float = _END_S) -> None:
        """Let it end by itself after a stop; then kill it."""
        if self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(patience_s)
            self._process.kill()
            self._process.wait()
