"""Running `heliarch` in tests of commands: in this process, or as one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from running import REPOSITORY
from typer.testing import CliRunner, Result

from launch_scripts.app import app


def heliarch(*words: str | Path) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(app, [str(word) for word in words])


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


def process(*words: str | Path, cwd: Path) -> subprocess.Popen[str]:
    """Start a command as a process."""
    return subprocess.Popen(
        [sys.executable, "-m", "launch_scripts", *map(str, words)],
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
