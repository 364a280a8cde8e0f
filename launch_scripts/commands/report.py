"""`heliarch report`: the page with a run's figures and tables."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import typer

from launch_scripts.commands.options import ReportOption, RunArgument

EXAMPLE: Final = "heliarch report runs/oahu-20261121-120000-4711"


def report(run: RunArgument, page: ReportOption = None) -> None:
    """Write the figures and tables of a run as one HTML page, which opens without a network."""
    from studies.report.run_report import write_run_report

    typer.echo(f"report: {write_run_report(run, Path(page) if page else None)}")
