"""The entry point of `heliarch`: what must hold before anything slow is imported."""

from __future__ import annotations

import resource
import signal
import sys
from io import TextIOWrapper

from heliarch.own_modules import replaced_module

_LEAST_MEMORY_MB = 1200


def main() -> None:
    allowed_mb = resource.getrlimit(resource.RLIMIT_AS)[0] / 1e6
    if 0.0 <= allowed_mb < _LEAST_MEMORY_MB:  # OpenBLAS would wait for memory without an end.
        sys.exit(
            f"heliarch: ulimit -v: expected {_LEAST_MEMORY_MB} MB or more, got {allowed_mb:.0f} MB"
        )
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # There is nothing to clean up yet.
    if complaint := replaced_module():
        sys.exit(f"heliarch: {complaint}")
    from heliarch.cli.app import run_command

    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # Not every terminal has the lines of a tree.
    run_command(sys.argv[1:])
