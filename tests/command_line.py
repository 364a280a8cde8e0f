"""Running `heliarch` in tests of commands, in this process."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner, Result

from launch_scripts.cli import app


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
