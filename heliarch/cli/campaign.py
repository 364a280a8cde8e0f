"""`heliarch campaign`: thousands of simulated runs with random faults."""

from __future__ import annotations

import shlex
from functools import partial
from typing import Annotated, Final

from cyclopts import Parameter

from bus_schemas.errors import InputError
from heliarch.cli.boundary import FAILED, OK
from heliarch.cli.options import ResultOptions, Scenario, Settings, Workers, changed_scenario
from heliarch.cli.output import publish, shared
from scenarios.run_options import RunOptions

_LISTED: Final = 10
_STANDBY: Final = 'standby=["central","supervisors"]'


def campaign(
    scenario: Scenario = "oahu",
    /,
    *,
    seeds: Annotated[str, Parameter(metavar="SEEDS")] = "1..100",
    start: Annotated[str | None, Parameter("--from", metavar="TIME")] = None,
    duration: Annotated[str, Parameter(metavar="TIME")] = "150s",
    workers: Workers = 1,
    settings: Settings = None,
    files: ResultOptions = ResultOptions(),
) -> int:
    """Kill, freeze, cut off and disturb controllers at random, and check that the plant stays safe.

    Each seed is one simulated run; seed 0 has no faults but the scenario's own, which every seed
    has. If a run breaks an invariant (docs/resilience.md), prints a command that repeats it with
    the shortest list of faults that still breaks it. Exit status 1: an invariant was broken.
    --report writes campaign.html by default.

    Example: `heliarch campaign oahu --seeds 1..200 --workers 2`

    Parameters
    ----------
    seeds
        Seeds of the faults, such as 1..1000.
    start
        Local time of the first cycle: 12:30, or 2010-04-01T12:30.
    duration
        Length of each run: 150s, 10m.
    """
    from scenarios.preparation import prepare
    from studies.campaign import results, study
    from studies.compare.cases import parse_seeds

    listed, options = parse_seeds(seeds), RunOptions(start=start, duration=duration)
    preparation = prepare(changed_scenario(scenario, files.data, settings), options, "campaign")
    plan = preparation.plan
    length_s, least_s = plan.timing.cycles * plan.timing.cycle_s, study.least_length_s(plan)
    if length_s < least_s:
        raise InputError(f"--duration: expected {least_s:g} s or more, got {length_s:g} s")
    if plan.supervision.restart.when == "never":
        raise InputError("restart.when: expected that controllers come back, got never")
    outcomes = shared(partial(study.run_seed, study.campaign(preparation)), listed, workers, "runs")
    broken = [outcome for outcome in outcomes if outcome.violations]
    # The command that repeats a run, without the faults and standbys of its seed.
    again = ["heliarch", "simulate", scenario, "--duration", duration]
    again += ["--from", start] if start else []
    again += ["--data", str(files.data)] if files.data else []
    more = []
    for outcome in broken[:_LISTED]:
        first = outcome.violations[0]
        changes = [*(settings or ()), *([_STANDBY] if outcome.standby else [])]
        words = [word for one in changes for word in ("--set", one)]
        words += [word for rule in outcome.rules for word in ("--fault", rule)]
        more += [
            f"seed {outcome.seed}: {first.invariant}, cycle {first.cycle}: {first.text}",
            f"  {shlex.join([*again, *words])}",
        ]
    publish(results.campaign_result(preparation, outcomes), files, "campaign.html", *more)
    return FAILED if broken else OK
