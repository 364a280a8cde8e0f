"""What becomes of a process when the one that started it dies without a word, killed for instance.

`python -m agents.parent_death PARENT PROGRAM ARGUMENT...` becomes a foreign program that dies with
the process of the number PARENT.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_SET_PARENT_DEATH_SIGNAL = 1
"""PR_SET_PDEATHSIG of prctl(2). It outlives execve(2)."""


def on_parent_death(death_signal: signal.Signals = signal.SIGKILL) -> None:
    """Ask the kernel for a signal when the parent of this process dies, where it can (Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, int(death_signal))


def main(words: list[str]) -> None:
    """Become a program that dies with its parent."""
    parent, *command = words
    on_parent_death()
    if os.getppid() == int(parent):  # It may have died in the meantime.
        os.execv(command[0], command)


if __name__ == "__main__":
    main(sys.argv[1:])
