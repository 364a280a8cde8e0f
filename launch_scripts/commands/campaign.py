"""`heliarch campaign`: thousands of simulated runs with random faults."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated, Final

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.options import (
    DataOption,
    JsonOption,
    ScenarioArgument,
    SettingsOption,
    StartOption,
    WorkersOption,
)
from launch_scripts.commands.output import counted, say, write_json
from studies.tables import console_for, print_table

if TYPE_CHECKING:
    from studies.campaign.study import Outcome

EXAMPLE: Final = "heliarch campaign oahu --seeds 1..200 --workers 2"
_LISTED: Final = 10


def campaign(
    scenario: ScenarioArgument = "oahu",
    seeds: Annotated[
        str, typer.Option(help="Seeds of the faults, such as 1..1000.", metavar="SEEDS")
    ] = "1..100",
    start: StartOption = None,
    duration: Annotated[
        str, typer.Option(help="Length of each run: 150s, 10m.", metavar="TIME")
    ] = "150s",
    settings: SettingsOption = None,
    workers: WorkersOption = 1,
    data: DataOption = None,
    json: JsonOption = None,
) -> None:
    """Kill, freeze, cut off and disturb controllers at random, and check that the plant stays safe.

    Each seed is one simulated run. A seed that breaks an invariant (docs/resilience.md) is shrunk
    to the shortest list of faults that does, and printed as a command that repeats it. Exit status
    1: an invariant was broken.
    """
    from launch_scripts.scenarios.preparation import RunOptions, prepare
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.campaign import study, tables
    from studies.compare.cases import parse_seeds, with_settings
    from studies.workers import share_work

    found = with_settings(load_scenario(scenario, data), tuple(settings or ()))
    preparation = prepare(found, RunOptions(start, duration), "campaign")
    length_s = preparation.plan.cycles * preparation.plan.cycle_ns / 1e9
    least_s = study.least_length_s(preparation.plan)
    if length_s < least_s:
        raise InputError(f"--duration: expected {least_s:g} s or more, got {length_s:g} s")
    chosen = parse_seeds(seeds)
    console = console_for(json)
    shared = share_work(partial(study.run_seed, study.campaign(preparation)), chosen, workers)
    outcomes = dict(counted(shared, "seeds", len(chosen), console))
    ordered = [outcomes[place] for place in sorted(outcomes)]
    write_json(ordered, json)
    print_table(console, tables.campaign_table(preparation, ordered))
    broken = [outcome for outcome in ordered if outcome.violations]
    for outcome in broken[:_LISTED]:
        first = outcome.violations[0]
        say(console, f"seed {outcome.seed}: {first.invariant}, cycle {first.cycle}: {first.text}")
        say(console, f"  {_command(scenario, start, duration, settings or (), outcome)}")
    if len(broken) > _LISTED:
        say(console, f"and {len(broken) - _LISTED:,} other seeds; --json lists all of them")
    if broken:
        raise typer.Exit(1)


def _command(
    scenario: str, start: str | None, duration: str, settings: Sequence[str], outcome: Outcome
) -> str:
    """Return the command that repeats a run."""
    words = ["heliarch", "simulate", scenario, "--duration", duration]
    words += ["--from", start] if start else []
    for setting in settings:
        words += ["--set", setting]
    for rule in outcome.rules:
        words += ["--fault", rule]
    return shlex.join(words)
