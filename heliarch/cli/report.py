"""`heliarch report`: the page with a run's figures and tables."""

from __future__ import annotations

from pathlib import Path

from heliarch.cli.options import Report, Run
from heliarch.cli.output import Output


def report(run: Run, /, *, page: Report = None) -> None:
    """Write the figures and tables of a run as one HTML page.

    It opens without a network.

    Example: `heliarch report runs/oahu-20261121-120000-4711`
    """
    from results.report.run_report import write_run_report

    Output().say(f"report: {write_run_report(run, Path(page) if page else None)}")
