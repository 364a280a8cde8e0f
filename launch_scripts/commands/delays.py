"""`heliarch delays`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from launch_scripts.commands.options import (
    DataOption,
    DurationOption,
    JsonOption,
    SeedOption,
    StartOption,
)

EXAMPLE: Final = "heliarch delays oahu --start 12:30 --duration 20m --report delays.html"


def delays(
    scenario: Annotated[
        str | None,
        typer.Argument(
            help="A shipped scenario or a TOML file; default the hour from noon of oahu-day, with "
            "a commitment of 0.6 of what is possible.",
            show_default=False,
        ),
    ] = None,
    start: StartOption = None,
    duration: DurationOption = None,
    seed: SeedOption = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="A field of the scenario and its value.", metavar="FIELD=VALUE"),
    ] = None,
    workers: Annotated[int, typer.Option(help="Processes that share the runs.")] = 2,
    data: DataOption = None,
    report: Annotated[Path | None, typer.Option(help="Write an HTML page.", metavar="FILE")] = None,
    json: JsonOption = None,
) -> None:
    """Show how much delay and loss the control survives, and how slow a central controller."""
    from launch_scripts.commands.delays_work import StudyRequest
    from launch_scripts.commands.timing_work import studied

    request = StudyRequest(
        scenario, start, duration, seed, tuple(settings or ()), data, workers, json, report
    )
    raise typer.Exit(studied(request))
