"""Running `heliarch` in tests of commands: in this process, or as one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import BytesIO, TextIOWrapper
from pathlib import Path

from running import REPOSITORY

from heliarch.cli.app import run_command


@dataclass(frozen=True)
class Result:
    """What a command printed, and its exit status."""

    exit_code: int
    stdout: str
    stderr: str

    @property
    def output(self) -> str:
        return self.stdout + self.stderr


def heliarch(*words: str | Path) -> Result:
    """Run a command in this process."""
    out, errors = (TextIOWrapper(BytesIO(), "utf-8", write_through=True) for _ in range(2))
    status: object = 0
    with redirect_stdout(out), redirect_stderr(errors):
        try:
            run_command([str(word) for word in words])
        except SystemExit as end:
            status = end.code
    assert isinstance(status, int)
    for stream in (out, errors):
        stream.seek(0)
    return Result(status, out.read(), errors.read())


def done(*words: str | Path) -> str:
    """Run a command that succeeds; return what it prints."""
    result = heliarch(*words)
    assert result.exit_code == 0, result.output
    return result.stdout


def refusal(*words: str | Path, status: int = 2) -> str:
    """Run a command that refuses; return its one line."""
    result = heliarch(*words)
    assert result.exit_code == status, result.output
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("heliarch: ")
    return line


def process(*words: str | Path, cwd: Path, program: str = "") -> subprocess.Popen[str]:
    """Start a command as a process, by another program if one is named."""
    return subprocess.Popen(
        [*program.split(), sys.executable, "-m", "heliarch", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        process_group=0,
    )


def python(
    code: str,
    *words: str | Path,
    cwd: Path = REPOSITORY,
    variables: Mapping[str, str] = {},
    status: int = 0,
) -> subprocess.CompletedProcess[str]:
    """Run Python code in a process of its own, which ends with an exit status."""
    paths = f"{REPOSITORY}:{REPOSITORY / 'tests'}"
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": paths, **variables},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == status, done.stderr
    return done
