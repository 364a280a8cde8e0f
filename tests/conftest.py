"""Fixtures that tests share."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from running import REPOSITORY, Device, Start, commands_in, small_plant

# How long an example takes to make or to check is the machine's affair. The same examples are
# tried each time, so that a change fails for what it changes; `make soak` tries others.
settings.register_profile(
    "the same", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("others", settings.get_profile("the same"), derandomize=False)
settings.load_profile("the same")


def pytest_configure() -> None:
    """Make the surroundings the same wherever the tests run.

    Tables are those of a terminal of 80 columns. Skies are not kept in the user's cache.
    Signals are heard, by the commands under test too: a shell without job control starts what runs
    in the background with SIGINT ignored, `nohup` with SIGHUP, and a process hands that on to those
    that it starts.
    """
    os.environ["COLUMNS"] = "80"
    os.environ["XDG_CACHE_HOME"] = str(REPOSITORY / ".pytest_cache")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_finish() -> None:
    """Keep the garbage collector off all that was imported: code under test calls it often."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say in one line which tests were not tried here, and why."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(str(one.longrepr[2]).removeprefix("Skipped: ") for one in skipped)
    if reasons:
        listed = "; ".join(f"{why} ({count})" for why, count in sorted(reasons.items()))
        terminalreporter.write_line(f"{len(skipped)} tests were not tried here: {listed}")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of the real measurements; the test is skipped where they are absent."""
    folder = Path(os.environ.get("HELIARCH_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real measurements are absent: no folder {folder} (see HELIARCH_DATA)")
    return folder


@pytest.fixture
def heliarch(tmp_path: Path) -> Iterator[Start]:
    """Start `heliarch` commands, each with a folder of its own; nothing outlives the test."""
    with commands_in(tmp_path) as start:
        yield start


@pytest.fixture
def plant(tmp_path: Path) -> str:
    """A scenario of four inverters in two clusters."""
    return small_plant(tmp_path / "plant")


@pytest.fixture
def device() -> Iterator[Device]:
    """Start programs; none outlives the test."""
    started: list[subprocess.Popen[bytes]] = []

    def start(program: Path, *words: object) -> subprocess.Popen[bytes]:
        started.append(subprocess.Popen([sys.executable, str(program), *map(str, words)]))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()
