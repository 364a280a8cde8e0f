"""The device's program: started for each launch, killed and started again where one says so."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from bus_schemas.errors import InputError

_END_S: Final = 10.0


class Device:
    """A program that is started by a command; without one the user starts it."""

    def __init__(self, command: str | None, node: str) -> None:
        self.can_restart = command is not None
        self._command = command or ""
        self._node = node
        self._log = Path()
        self._process: subprocess.Popen[bytes] | None = None
        if self.can_restart:
            self.words(Path("plan.json"))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.end(0.0)

    def words(self, plan: Path) -> list[str]:
        words: list[str] = []
        with suppress(ValueError, KeyError, IndexError):
            words = [word.format(plan=plan, node=self._node) for word in shlex.split(self._command)]
        if not words or shutil.which(words[0]) is None:
            expected = "a program that is there, with its words"
            raise InputError.of("--command", f"expected {expected}, got {self._command!r}")
        return words

    def start(self, plan: Path) -> None:
        """Start it, unless it runs; its output goes to device.log beside the launches."""
        if self.can_restart and (self._process is None or self.end_text):
            self._log = plan.parents[1] / "device.log"
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
