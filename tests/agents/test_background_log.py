"""A log that is written by a thread of its own loses no line, however its process ends."""

from __future__ import annotations

import logging
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from agents.background_log import log_in_background

BEGINNING = """
import logging, os, sys
from agents.background_log import log_in_background
from agents.lifeline import end_at_once
from agents.process_setup import join_run
join_run(attached=False)
log_in_background(longest_flush_s=60.0)
log = logging.getLogger("a process")
for number in range(2000):
    log.info("line %d", number)
"""


class SlowHandler(logging.Handler):
    """Writes a line only when it is let."""

    def __init__(self) -> None:
        super().__init__()
        self.may_write = threading.Event()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.may_write.wait(60.0)
        self.lines.append(record.getMessage())


@pytest.fixture
def slow() -> Iterator[SlowHandler]:
    root = logging.getLogger()
    before, level = root.handlers, root.level
    handler = SlowHandler()
    root.handlers = [handler]
    root.setLevel(logging.INFO)
    yield handler
    handler.may_write.set()
    for now in root.handlers:
        now.flush()
    root.handlers, root.level = before, level


def lines_of_a_process(ending: str) -> tuple[int, list[str]]:
    done = subprocess.run(
        [sys.executable, "-c", BEGINNING + ending],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return done.returncode, done.stderr.splitlines()


@pytest.mark.parametrize(
    ("ending", "status"),
    [("", 0), ("raise SystemExit(3)", 3), ("end_at_once()", 1), ("1 / 0", 1)],
)
def test_every_line_is_there_at_the_end(ending: str, status: int) -> None:
    code, lines = lines_of_a_process(ending)
    assert code == status
    # What the interpreter itself says of an exception is no line of the log.
    numbers = [int(line.rsplit(" ", 1)[1]) for line in lines if " INFO line " in line]
    assert numbers == list(range(2000))


def test_an_error_is_written_before_the_process_goes_on() -> None:
    _, lines = lines_of_a_process('log.error("the last words"); os._exit(1)')
    assert lines[-1].endswith("ERROR the last words")
    assert len(lines) == 2001


def test_whoever_logs_does_not_wait_for_the_line_to_be_written(slow: SlowHandler) -> None:
    log_in_background(longest_flush_s=60.0)
    logging.getLogger().info("a word")
    assert slow.lines == []
    slow.may_write.set()
    logging.getLogger().handlers[0].flush()
    assert slow.lines == ["a word"]


def test_an_exception_is_logged_with_where_it_came_from(slow: SlowHandler) -> None:
    slow.may_write.set()
    log_in_background(longest_flush_s=60.0)
    try:
        raise ValueError("no such thing")
    except ValueError:
        logging.getLogger().exception("gives up")
    (line,) = slow.lines
    assert line.startswith("gives up")
    assert "ValueError: no such thing" in line
