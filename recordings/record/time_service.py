"""What the host's time service says of its clock: chrony, or the daemon of PTP (ptp4l)."""

from __future__ import annotations

import re
import subprocess
from contextlib import suppress
from typing import Final

_ASKED: Final = (
    (("chronyc", "-n", "tracking"), ("Reference ID", "System time", "RMS offset")),
    (("pmc", "-u", "-b", "0", "GET TIME_STATUS_NP"), ("master_offset", "gmPresent")),
)
"""Commands, and the lines of their output that tell how good the clock is."""

_PATIENCE_S: Final = 2.0


def clock_statement() -> str:
    """Return what they say in a line; empty where none is installed or answers."""
    found = []
    for command, names in _ASKED:
        said = ""
        with suppress(OSError, subprocess.SubprocessError):
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=_PATIENCE_S, check=True
            )
            said = done.stdout
        lines = (re.search(rf"^\s*{name}\s*:?\s+(.+?)\s*$", said, re.MULTILINE) for name in names)
        facts = [f"{name} {line[1]}" for name, line in zip(names, lines, strict=True) if line]
        found += [f"{command[0]}: {', '.join(facts)}"] if facts else []
    return "; ".join(found)
