"""`heliarch delays`: how much delay and loss the control survives."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.options import (
    DataOption,
    DurationOption,
    EndOption,
    JsonOption,
    ReportOption,
    SeedOption,
    SettingsOption,
    StartOption,
    WorkersOption,
)
from launch_scripts.commands.output import counted, say, write_json, write_page
from studies.tables import console_for

if TYPE_CHECKING:
    from rich.console import Console

    from launch_scripts.scenarios.preparation import Preparation, RunOptions
    from launch_scripts.scenarios.scenario import ScenarioFile
    from studies.delays.study import Outcome

EXAMPLE: Final = "heliarch delays oahu --from 12:30 --duration 20m --report"
PAGE_NAME: Final = "delays.html"

DEFAULT_SCENARIO: Final = "oahu-day"
DEFAULT_START: Final = "11:58"
DEFAULT_DURATION: Final = "62m"
DEFAULT_SETTINGS: Final = ("commitment.share=0.6",)
"""At 0.6 of what is possible no shortfall is unavoidable: what the network spoils stands out."""


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
    end: EndOption = None,
    duration: DurationOption = None,
    seed: SeedOption = None,
    settings: SettingsOption = None,
    workers: WorkersOption = 2,
    data: DataOption = None,
    report: ReportOption = None,
    json: JsonOption = None,
) -> None:
    """Measure what delays, losses and a slow central controller cost.

    Everything runs in memory: each scheme with each delay, share of losses and central period.
    --report writes delays.html by default.
    """
    from launch_scripts.scenarios.preparation import RunOptions
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.compare.cases import with_settings
    from studies.compare.study import remarks_of
    from studies.delays.results import print_study, study_page

    changes = tuple(settings or ())
    if scenario is None:
        scenario, start = DEFAULT_SCENARIO, start or DEFAULT_START
        changes = (*DEFAULT_SETTINGS, *changes)
        if end is None:
            duration = duration or DEFAULT_DURATION
    console = console_for(json)
    changed = with_settings(load_scenario(scenario, data), changes)
    preparation = _prepared(changed, RunOptions(start, duration, seed=seed, end=end))
    outcomes = _outcomes(preparation, workers, console)
    document: dict[str, Any] = {
        "scenario": preparation.plan.plant,
        "start": preparation.local_start(),
        "cycles": preparation.plan.cycles,
        "cycle_s": preparation.plan.cycle_ns / 1e9,
        "settings": changes,
        "remarks": remarks_of(preparation),
        "outcomes": outcomes,
    }
    # Files first: whoever reads the tables may leave before their end.
    write_json(document, json)
    page = Path(report or PAGE_NAME)
    if report is not None:
        write_page(study_page(preparation, outcomes), page)
    print_study(preparation, outcomes, console)
    if report is not None:
        say(console, f"report: {page}")


def _prepared(scenario: ScenarioFile, options: RunOptions) -> Preparation:
    """Work out the run; refuse one of which nothing would count."""
    from launch_scripts.scenarios.preparation import prepare
    from studies.delays.study import WARM_UP_S

    preparation = prepare(scenario, options, "delays")
    if preparation.plan.faults:
        raise InputError(f"{scenario.path} faults: expected none, this study has its own")
    length_s = preparation.plan.cycles * preparation.plan.cycle_ns / 1e9
    if length_s <= WARM_UP_S:
        raise InputError(
            f"--duration: expected more than the {WARM_UP_S:g} s at the beginning of each run "
            f"that do not count, got {length_s:g} s"
        )
    return preparation


def _outcomes(preparation: Preparation, workers: int, console: Console) -> list[Outcome]:
    from studies.delays.study import conditions, counted_s, run_under
    from studies.workers import share_work

    plan = preparation.plan
    correction = preparation.scenario.scenario.control.correction
    chosen = conditions(plan.cycle_ns / 1e9, counted_s(plan), correction)
    shared = share_work(partial(run_under, plan, preparation.profile), chosen, workers)
    found = dict(counted(shared, "runs", len(chosen), console))
    return [found[number] for number in sorted(found)]
