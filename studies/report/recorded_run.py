"""The report of a recorded run: read from its recording, written beside it."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.markup import escape

from bus_schemas.errors import InputError
from recordings.read.reader import RunReader
from recordings.read.series import read_series
from studies.report.run_report import run_line, write_report
from studies.report.tables import health_table, metrics_tables
from sunspec.process import read_accounts
from sunspec.tables import devices_tables

REPORT_NAME: Final = "report.html"


def write_run_report(run: Path, out: Path | None = None) -> Path:
    """Write the report of a recorded run, by default beside its recording; return where it is."""
    console = Console(stderr=True)
    with RunReader(run) as reader:
        path, plan = out or reader.path.with_name(REPORT_NAME), reader.plan
        notes = _notes(reader)
        size_mb = reader.path.stat().st_size / 1e6
        with console.status(f"reading {size_mb:,.0f} MB of {escape(str(run))}"):
            series = replace(read_series(run), label=f"hierarchical ({plan.scheme})")
            devices = devices_tables(read_accounts(reader.path.parent))
            tables = [health_table(reader), *metrics_tables([series]), *devices]
    with console.status("drawing"):
        title = f"{plan.plant}: run {plan.run_id}"
        write_report(path, title, [series], tables, notes, lead=run_line(plan))
    return path


def _notes(reader: RunReader) -> list[str]:
    """Return what the recording says about the run."""
    scenario = _scenario(reader)
    origin = reader.metadata.get("run", {})
    notes = [
        f"Scenario: {scenario.get('title', reader.plan.plant)}.",
        f"Recorded by heliarch {origin.get('driver', '')}, "
        f"version {origin.get('version heliarch', 'unknown')}, in {reader.path.name}.",
    ]
    if scenario.get("neighbours", {}).get("history") == "hindsight":
        notes.append("Clusters and neighbours were chosen from the run's own data: hindsight.")
    if not reader.whole:
        notes.append("The recording is incomplete: the report shows the part that it holds.")
    return notes


def _scenario(reader: RunReader) -> dict[str, Any]:
    """Return the scenario that the recording carries, as it stands in its file."""
    try:
        return tomllib.loads(reader.scenario)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{reader.path}: expected a scenario in TOML, got: {error}") from None
