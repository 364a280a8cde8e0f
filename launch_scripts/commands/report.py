"""`heliarch report`: the page with a run's figures and tables."""

from __future__ import annotations

from pathlib import Path

import typer


def report(run: Path, report: str | None = None) -> None:
    """Write the figures and tables of a run as one HTML page, which opens without a network.

    Example: heliarch report runs/oahu-20261121-120000-4711
    """
    from studies.report.run_report import write_run_report

    typer.echo(f"report: {write_run_report(run, Path(report) if report else None)}")
