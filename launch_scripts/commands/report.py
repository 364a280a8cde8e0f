"""`heliarch report`: the page with a run's figures and tables."""

# What does the work is imported when it runs: `--help` does not wait for it.
# ruff: noqa: PLC0415

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.options import RunArgument

if TYPE_CHECKING:
    from recordings.read.reader import RunReader

EXAMPLE: Final = "heliarch report runs/oahu-20261121-120000-4711"
REPORT_NAME: Final = "report.html"


def report(
    run: RunArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            help="The HTML file; default report.html in the run's folder.", metavar="FILE"
        ),
    ] = None,
) -> None:
    """Write the figures and tables of a run as one HTML page, which opens without a network."""
    typer.echo(f"report: {write_run_report(run, out)}")


def write_run_report(run: Path, out: Path | None = None) -> Path:
    """Write the report of a recorded run; return where it is.

    Raises
    ------
    InputError
        There is no such run, no cycle of it is complete, or the report cannot be put there.
    """
    from rich.console import Console
    from rich.markup import escape

    from recordings.read.reader import RunReader
    from recordings.read.series import read_series
    from studies.report.metrics_tables import metrics_tables
    from studies.report.run_report import check_destination, write_report

    with RunReader(run) as reader:
        recording = reader.path
        path = out or recording.with_name(REPORT_NAME)
        check_destination(path)
        title = f"{reader.plan.plant}: run {reader.plan.run_id}"
        notes = _notes(reader)
        scheme = f"hierarchical ({reader.plan.scheme})"
    console = Console(stderr=True)
    # A day of cycles takes its time to read.
    with console.status(f"reading {recording.stat().st_size / 1e6:,.0f} MB of {escape(str(run))}"):
        series = replace(read_series(run), label=scheme)
    with console.status("drawing"):
        write_report(path, title, [series], metrics_tables([series]), notes)
    return path


def _notes(reader: RunReader) -> list[str]:
    """Return what the recording says about the run."""
    scenario = _scenario(reader)
    origin = reader.metadata.get("run", {})
    notes = [f"Scenario: {scenario.get('title', reader.plan.plant)}."]
    notes.append(
        f"Recorded by heliarch {origin.get('driver', '')} (version "
        f"{origin.get('version heliarch', 'not stated')}) into {reader.path.name}."
    )
    if scenario.get("neighbours", {}).get("history") == "hindsight":
        notes.append("Clusters and neighbours were chosen from the run's own data: hindsight.")
    if not reader.whole:
        notes.append("The recording was cut short: the report shows what it holds.")
    return notes


def _scenario(reader: RunReader) -> dict[str, Any]:
    """Return the scenario that the recording carries, as it stands in its file."""
    try:
        return tomllib.loads(reader.scenario)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{reader.path}: expected a scenario in TOML, got {error}") from None
