"""`heliarch campaign`: thousands of simulated runs with random faults."""

from __future__ import annotations

import shlex
from functools import partial
from typing import Final

from bus_schemas.errors import InputError
from launch_scripts.commands.boundary import FAILED, OK
from launch_scripts.commands.options import ResultOptions, changed_scenario
from launch_scripts.commands.output import publish, shared
from launch_scripts.scenarios.run_options import RunOptions

_LISTED: Final = 10


def campaign(
    scenario: str = "oahu",
    *,
    seeds: str = "1..100",
    start: str | None = None,
    duration: str = "150s",
    settings: list[str] | None = None,
    workers: int = 1,
    curves: bool = False,
    files: ResultOptions,
) -> int:
    """Kill, freeze, cut off and disturb controllers at random, and check that the plant stays safe.

    Each seed is one simulated run. If a run breaks an invariant
    (docs/resilience.md), prints a command that repeats it with the shortest
    list of faults that still breaks it. Exit status 1: an invariant was
    broken. --report writes campaign.html by default.

    --seeds SEEDS: Seeds of the faults, such as 1..1000.
    --from TIME (start): Local time of the first cycle: 12:30, or 2010-04-01T12:30.
    --duration TIME: Length of each run: 150s, 10m.
    --curves: Instead, measure what failures cost, by rate and repair time.
    Example: heliarch campaign oahu --seeds 1..200 --workers 2
    """
    from launch_scripts.scenarios.preparation import prepare
    from studies.campaign import curves as failures
    from studies.campaign import results, study
    from studies.compare.cases import parse_seeds

    changed = changed_scenario(scenario, files.data, settings)
    preparation = prepare(changed, RunOptions(start, duration), "campaign")
    plan = preparation.plan
    length_s, least_s = plan.cycles * plan.cycle_ns / 1e9, study.least_length_s(plan)
    if length_s < least_s:
        raise InputError(f"--duration: expected {least_s:g} s or more, got {length_s:g} s")
    chosen = parse_seeds(seeds)
    found = study.campaign(preparation)
    if curves:
        conditions = failures.conditions(chosen)
        points = shared(partial(failures.run_under, found), conditions, workers, "runs")
        publish(results.curves_result(preparation, points), files, "campaign.html")
        return OK
    outcomes = shared(partial(study.run_seed, found), chosen, workers, "runs")
    broken = [outcome for outcome in outcomes if outcome.violations]
    # The command that repeats a run, without its faults.
    words = ["heliarch", "simulate", scenario, "--duration", duration]
    words += ["--from", start] if start else []
    words += [word for setting in settings or () for word in ("--set", setting)]
    more = []
    for outcome in broken[:_LISTED]:
        first = outcome.violations[0]
        faults = [word for rule in outcome.rules for word in ("--fault", rule)]
        more += [
            f"seed {outcome.seed}: {first.invariant}, cycle {first.cycle}: {first.text}",
            f"  {shlex.join([*words, *faults])}",
        ]
    publish(results.campaign_result(preparation, found, outcomes), files, "campaign.html", *more)
    return FAILED if broken else OK
