"""Fixtures that tests share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from running import Heliarch

REPOSITORY = Path(__file__).parent.parent


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of the real measurements; the test is skipped where they are absent."""
    folder = Path(os.environ.get("HELIARCH_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real measurements are absent: no folder {folder} (see HELIARCH_DATA)")
    return folder


@pytest.fixture
def heliarch(tmp_path: Path) -> Iterator[Callable[..., Heliarch]]:
    """Start `heliarch` commands, each with a folder of its own; nothing outlives the test."""
    started: list[Heliarch] = []

    def start(*words: str) -> Heliarch:
        command = Heliarch(tmp_path / f"run{len(started)}", *words)
        started.append(command)
        return command

    yield start
    for command in started:
        command.process.kill()
        command.process.wait()
        for process in command.processes():
            process.kill()
