"""`heliarch delays`: how much delay and loss the control survives."""

from __future__ import annotations

from functools import partial

from bus_schemas.errors import InputError
from launch_scripts.commands.options import ResultOptions, changed_scenario
from launch_scripts.commands.output import publish, shared
from launch_scripts.scenarios.run_options import RunOptions, TimeOptions


def delays(
    scenario: str | None = None,
    *,
    span: TimeOptions,
    seed: int | None = None,
    settings: list[str] | None = None,
    workers: int = 2,
    files: ResultOptions,
) -> None:
    """Measure what delays, losses and a slow central controller cost.

    Everything runs in memory: each scheme with each delay, share of losses and central period.
    --report writes delays.html by default.

    SCENARIO: A shipped scenario or a TOML file; default the hour from noon of oahu-day, with a
        commitment of 0.6 of what is possible.
    Example: heliarch delays oahu --from 12:30 --duration 20m --report
    """
    from launch_scripts.scenarios.preparation import prepare
    from studies.delays.results import study_result
    from studies.delays.study import WARM_UP_S, conditions, run_under

    changes, start, duration = tuple(settings or ()), span.start, span.duration
    if scenario is None:
        # With this share no shortfall is unavoidable: what the network spoils stands out.
        scenario, changes = "oahu-day", ("commitment.share=0.6", *changes)
        start, duration = start or "11:58", duration or (None if span.end else "62m")
    changed = changed_scenario(scenario, files.data, changes)
    preparation = prepare(changed, RunOptions(start, duration, seed=seed, end=span.end), "delays")
    plan = preparation.plan
    if plan.faults:
        raise InputError(f"{changed.path} faults: expected none, this study has its own")
    if plan.cycles * plan.cycle_ns <= WARM_UP_S * 1e9:
        begin = f"the first {WARM_UP_S:g} s, which do not count"
        raise InputError(f"--duration: expected more than {begin}")
    run = partial(run_under, plan, preparation.profile)
    outcomes = shared(run, conditions(plan), workers, "runs")
    publish(study_result(preparation, changes, outcomes), files, "delays.html")
