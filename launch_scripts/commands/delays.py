"""`heliarch delays`: how much delay and loss the control survives."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.options import (
    ResultOptions,
    SeedOption,
    SettingsOption,
    WorkersOption,
    changed_scenario,
)
from launch_scripts.commands.output import publish, shared
from launch_scripts.scenarios.run_options import RunOptions, TimeOptions

if TYPE_CHECKING:
    from launch_scripts.scenarios.preparation import Preparation
    from launch_scripts.scenarios.scenario import ScenarioFile

EXAMPLE: Final = "heliarch delays oahu --from 12:30 --duration 20m --report"
PAGE: Final = Path("delays.html")

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
    *,
    span: TimeOptions,
    seed: SeedOption = None,
    settings: SettingsOption = None,
    workers: WorkersOption = 2,
    files: ResultOptions,
) -> None:
    """Measure what delays, losses and a slow central controller cost.

    Everything runs in memory: each scheme with each delay, share of losses and central period.
    --report writes delays.html by default.
    """
    from studies.delays.results import study_result
    from studies.delays.study import conditions, counted_s, run_under

    changes, start, duration = tuple(settings or ()), span.start, span.duration
    if scenario is None:
        scenario, start = DEFAULT_SCENARIO, start or DEFAULT_START
        changes = (*DEFAULT_SETTINGS, *changes)
        if span.end is None:
            duration = duration or DEFAULT_DURATION
    changed = changed_scenario(scenario, files.data, changes)
    preparation = _prepared(changed, RunOptions(start, duration, seed=seed, end=span.end))
    plan = preparation.plan
    chosen = conditions(plan.cycle_ns / 1e9, counted_s(plan))
    run = partial(run_under, plan, preparation.profile)
    outcomes = shared(run, chosen, workers, "runs")
    publish(study_result(preparation, changes, outcomes), files, PAGE)


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
