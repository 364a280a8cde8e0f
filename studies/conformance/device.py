"""The device's program: started for each trial, killed and started again where a trial says so."""

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
        self._command = command
        self._node = node
        self._log = folder / "device.log"
        self._process: subprocess.Popen[bytes] | None = None
        if command is not None and not self._words(folder):
            raise InputError(
                f"--command: expected a program that is there, with its words, got {command!r}"
            )

    def __enter__(self) -> Device:
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()

    def start(self, plan: Path) -> None:
        """Start it, unless it runs."""
        if self._command is None or (self._process and self._process.poll() is None):
            return
        self._log.parent.mkdir(parents=True, exist_ok=True)
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(self._words(plan), stdout=log, stderr=log)

    def _words(self, plan: Path) -> list[str]:
        """Return the command's words; none if it is no command."""
        try:
            words = [
                word.format(plan=plan, node=self._node) for word in shlex.split(self._command or "")
            ]
        except (ValueError, KeyError, IndexError):
            return []
        return words if words and shutil.which(words[0]) else []

    @property
    def end_text(self) -> str:
        """How its program has ended, and where its last words are; empty if it runs."""
        if self._process is None or self._process.poll() is None:
            return ""
        return f"its program has ended with status {self._process.returncode}, see {self._log}"

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def end(self) -> None:
        """Let it end by itself after a stop; then at once."""
        if self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_END_S)
            self.kill()
