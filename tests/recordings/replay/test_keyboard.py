"""Keys are understood, and the terminal is as before, however a replay ends."""

from __future__ import annotations

import os
import pty
from collections.abc import Iterator

import pytest

from recordings.replay.keyboard import DOWN, LEFT, RIGHT, UP, keyboard


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[int, int]]:
    """Both ends of a terminal that is standard input: where one types, and what is read."""
    typing, seen = pty.openpty()
    with open(seen, encoding="utf-8", closefd=False) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield typing, seen
    os.close(typing)
    os.close(seen)


def test_keys_are_read_one_by_one_also_if_an_arrow_comes_in_two_parts(
    terminal: tuple[int, int],
) -> None:
    typing, _ = terminal
    with keyboard() as pressed:
        os.write(typing, b"s+-=q\x1b[A\x1b[Bx\x1b[C\x1bOD\x1b[")
        expected = ["s", "+", "-", "=", "q", UP, DOWN, RIGHT, LEFT, ""]
        assert [pressed(0.0) for _ in expected] == expected
        os.write(typing, b"C")
        assert pressed(10.0) == RIGHT
