"""`heliarch clusters`: what virtual neighbours are worth beside other ways to choose clusters."""

from __future__ import annotations

from functools import partial

from agents.settings import Scheme
from launch_scripts.commands.options import ResultOptions, changed_scenario
from launch_scripts.commands.output import publish, shared
from launch_scripts.scenarios.run_options import RunOptions, TimeOptions


def clusters(
    scenario: str = "oahu",
    *,
    span: TimeOptions,
    periods: str | None = None,
    random: int = 20,
    seed: int | None = None,
    scheme: Scheme | None = None,
    learn: str | None = None,
    settings: list[str] | None = None,
    workers: int = 1,
    files: ResultOptions,
) -> None:
    """Compare virtual neighbours with geographic and random clusters.

    --report writes clusters.html by default.

    --periods SECONDS: Periods of the central controller, in seconds; default those of 1,10,60 that
        the cycle allows.
    --random NUMBER 1..1000: How many random choices of clusters to try.
    --learn TIME: Choose clusters from this first part of the run, then run the rest.
    Example: heliarch clusters oahu --random 50 --periods 1,30 --report
    """
    from bus_schemas.times import parse_duration_s
    from launch_scripts.scenarios.preparation import prepare
    from studies.clusters.results import study_result
    from studies.clusters.study import (
        Arrange,
        by_first_part,
        by_scenario,
        central_periods,
        study_clusters,
    )
    from studies.compare.study import remarks_of

    changed = changed_scenario(scenario, files.data, settings)
    options = RunOptions(**vars(span), seed=seed, scheme=scheme)
    preparation = prepare(changed, options, "clusters")
    arrange: Arrange = partial(by_scenario, changed, options)
    remarks = remarks_of(preparation)
    if learn is not None:
        learn_s = parse_duration_s(learn, "--learn")
        arrange = by_first_part(preparation, learn_s)
        remarks = (
            *preparation.remarks,
            f"Clusters and neighbours were chosen from the first {learn_s:g} s; the rest was run.",
        )
    study = study_clusters(
        preparation,
        arrange,
        central_periods(periods, preparation.plan),
        random,
        partial(shared, workers=workers, description="clusters"),
    )
    publish(study_result(study, remarks), files, "clusters.html")
