"""Keys are understood, and the terminal is as before, however it ends."""

from __future__ import annotations

import os
import pty
import termios
from collections.abc import Iterator

import pytest

from recordings.replay.keyboard import Key, NoKeyboard, has_keyboard, keyboard, keys_in, keys_of


@pytest.mark.parametrize(
    ("typed", "keys"),
    [
        (b" ", [Key.PAUSE]),
        (b"s+-=q", [Key.STEP, Key.FASTER, Key.SLOWER, Key.FASTER, Key.QUIT]),
        (b"\x1b[A\x1b[B", [Key.FAR_FORWARD, Key.FAR_BACK]),
        (b"\x1b[C\x1b[D", [Key.FORWARD, Key.BACK]),
        (b"\x1bOC", [Key.FORWARD]),
        (b"xyz", []),
        (b"x\x1b[Cs", [Key.FORWARD, Key.STEP]),
        (b"\x1b", []),
        (b"\x1b[", []),
        (b"", []),
    ],
)
def test_bytes_of_a_terminal_are_keys(typed: bytes, keys: list[Key]) -> None:
    assert keys_in(typed) == keys


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """Both ends of a terminal: where one types, and what the program sees."""
    typing, seen = pty.openpty()
    yield typing, seen
    os.close(typing)
    os.close(seen)


def test_a_key_comes_without_return_and_unseen(terminal: tuple[int, int]) -> None:
    typing, seen = terminal
    with keys_of(seen) as keys:
        assert keys.wait(0.0) == []
        os.write(typing, b" \x1b[C")
        found = keys.wait(10.0)
        mode = termios.tcgetattr(seen)[3]
    assert found == [Key.PAUSE, Key.FORWARD]
    assert not mode & (termios.ICANON | termios.ECHO)
    assert mode & termios.ISIG  # Ctrl-C stays what it is


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_the_terminal_is_restored_however_it_ends(
    terminal: tuple[int, int], error: type[BaseException]
) -> None:
    _, seen = terminal
    before = termios.tcgetattr(seen)
    modes = []

    def use_it_and_fail() -> None:
        with keys_of(seen):
            modes.append(termios.tcgetattr(seen))
            raise error

    with pytest.raises(error):
        use_it_and_fail()
    assert modes != [before]
    assert termios.tcgetattr(seen) == before


def test_without_a_terminal_nobody_presses_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull, encoding="utf-8") as nothing:  # noqa: PTH123 - os.devnull is text
        monkeypatch.setattr("sys.stdin", nothing)
        assert not has_keyboard()
        with keyboard() as keys:
            assert isinstance(keys, NoKeyboard)
            assert keys.wait(0.001) == []
