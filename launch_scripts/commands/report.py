"""`heliarch report`: the page with a run's figures and tables."""

from __future__ import annotations

import sys
from pathlib import Path

from bus_schemas.errors import InputError
from studies.report.recorded_run import REPORT_NAME, write_run_report

__all__ = ["REPORT_NAME", "report", "write_run_report"]


def report(run: Path, out: Path | None) -> int:
    """Write the report of a recorded run and say where it is. Returns the exit status."""
    try:
        path = write_run_report(run, out)
    except InputError as error:
        sys.stderr.write(f"heliarch: {error}\n")
        return 2
    sys.stdout.write(f"report: {path}\n")
    return 0
