"""Ctrl-C does not tear apart what is only starting."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from launch_scripts.interruption import interruptions_wait

_INTERRUPT_ONESELF = """
import os, signal
from launch_scripts.interruption import end_when_interrupted
os.kill(os.getpid(), signal.SIGINT)
print("imported", flush=True)
end_when_interrupted()
print("not reached")
"""


def is_held_back() -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_interruption_comes_after_the_block() -> None:
    done: list[bool] = []

    def interrupt_and_go_on() -> None:
        with interruptions_wait():
            signal.raise_signal(signal.SIGINT)
            done.append(is_held_back())

    with pytest.raises(KeyboardInterrupt):
        interrupt_and_go_on()
    assert done == [True]
    assert not is_held_back()


def test_a_process_that_is_started_meanwhile_ends_without_a_word_once_it_has_imported() -> None:
    with interruptions_wait():
        process = subprocess.Popen(
            [sys.executable, "-c", _INTERRUPT_ONESELF],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
    told, complained = process.communicate(timeout=60)
    assert (told, complained) == ("imported\n", "")
    assert process.returncode == -signal.SIGINT
