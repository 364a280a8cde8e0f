"""Keys are understood, and the terminal is as before, however a replay ends."""

from __future__ import annotations

import os
import pty
import termios
from collections.abc import Iterator

import pytest

from recordings.replay.keyboard import DOWN, LEFT, RIGHT, UP, TerminalKeyboard, keyboard


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[int, int]]:
    """Both ends of a terminal that is standard input: where one types, and what is read."""
    typing, seen = pty.openpty()
    with open(seen, encoding="utf-8", closefd=False) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield typing, seen
    os.close(typing)
    os.close(seen)


@pytest.mark.parametrize(
    ("typed", "keys"),
    [
        (b"s+-=q", ["s", "+", "-", "=", "q"]),
        (b"ss" * 100, ["s"] * 200),
        (b"\x1b[A\x1b[B", [UP, DOWN]),
        (b"\x1b[C\x1bOD", [RIGHT, LEFT]),
        (b"x\x1b[Cs\x1b", [RIGHT, "s"]),
        (b"xyz", []),
    ],
)
def test_every_key_is_read_at_once(
    typed: bytes, keys: list[str], terminal: tuple[int, int]
) -> None:
    typing, _ = terminal
    with keyboard() as found:
        os.write(typing, typed)
        assert found(10.0) == keys
        assert found(0.0) == []


def test_an_arrow_key_may_come_in_two_parts() -> None:
    reading, writing = os.pipe()
    keys = TerminalKeyboard(reading)
    os.write(writing, b"s\x1b[")
    assert keys.wait(10.0) == ["s"]
    os.write(writing, b"C")
    assert keys.wait(10.0) == [RIGHT]
    os.close(reading)
    os.close(writing)


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_the_terminal_is_restored(terminal: tuple[int, int], error: type[BaseException]) -> None:
    _, seen = terminal
    before = termios.tcgetattr(seen)

    def use_it_and_fail() -> None:
        with keyboard():
            mode = termios.tcgetattr(seen)[3]
            assert not mode & (termios.ICANON | termios.ECHO)
            assert mode & termios.ISIG  # Ctrl-C stays what it is
            raise error

    with pytest.raises(error):
        use_it_and_fail()
    assert termios.tcgetattr(seen) == before
