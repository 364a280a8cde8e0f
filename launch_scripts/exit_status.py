"""How a command ends: its exit status, and the line with which it says why."""

from __future__ import annotations

import sys
from typing import Final

OK: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
INTERRUPTED: Final = 130
"""As a shell tells of a program that Ctrl-C has ended: 128 and the number of the signal.

Of one that SIGTERM or SIGHUP has ended it tells 143 or 129: see `commands/termination.py`.
"""


def complain(text: object, status: int) -> int:
    """Say on standard error why a command ends; return its exit status."""
    sys.stderr.write(f"heliarch: {text}\n")
    return status
