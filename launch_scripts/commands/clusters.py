"""`heliarch clusters`: what virtual neighbours are worth beside other ways to choose clusters."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from launch_scripts.commands.options import (
    ResultOptions,
    ScenarioArgument,
    SchemeOption,
    SeedOption,
    SettingsOption,
    TimeOptions,
    WorkersOption,
    changed_scenario,
)
from launch_scripts.commands.output import counted, say, write_files
from studies.tables import console_for, print_lines, print_table

EXAMPLE: Final = "heliarch clusters oahu --random 50 --periods 1,30 --report"
PAGE: Final = Path("clusters.html")


def clusters(
    scenario: ScenarioArgument = "oahu",
    *,
    span: TimeOptions,
    periods: str | None = None,
    random: Annotated[
        int, typer.Option(min=1, max=1000, help="How many random choices of clusters to try.")
    ] = 20,
    seed: SeedOption = None,
    scheme: SchemeOption = None,
    learn: str | None = None,
    settings: SettingsOption = None,
    workers: WorkersOption = 1,
    files: ResultOptions,
) -> None:
    """Compare virtual neighbours with geographic and random clusters.

    --report writes clusters.html by default.

    --periods SECONDS: How often the central controller acts, seconds; default 1,10,60 as the cycle
        allows.
    --learn TIME: Choose clusters from a first part of the run, of this length; run the rest.
    """
    from bus_schemas.times import parse_duration_s
    from launch_scripts.scenarios.preparation import RunOptions, prepare
    from studies.clusters import results
    from studies.clusters import study as of_clusters
    from studies.clusters.worth import by_first_part, by_scenario
    from studies.compare.study import remarks_of

    changed = changed_scenario(scenario, files.data, settings)
    options = RunOptions(span.start, span.duration, seed=seed, scheme=scheme, end=span.end)
    preparation = prepare(changed, options, "clusters")
    plan = preparation.plan
    if learn is None:
        arrange, remarks = by_scenario(changed, options), remarks_of(preparation)
    else:
        learn_s = parse_duration_s(learn, "--learn")
        remark = (
            f"Clusters and neighbours were chosen from the first {learn_s:g} s; the rest was run."
        )
        arrange, remarks = by_first_part(preparation, learn_s), (*preparation.remarks, remark)
    control, inverters = changed.scenario.control, len(plan.inverters)
    central = of_clusters.central_periods(periods, plan)
    question = of_clusters.ClusterQuestion(
        arrange, control, inverters, plan.scheme, central, random
    )
    study = of_clusters.study_clusters(
        question, remarks, workers, lambda done, total: counted(done, "clusters", total)
    )
    document = results.study_json(study)
    written = write_files(
        document, files.json, lambda: results.study_page(study), files.report, PAGE
    )
    console = console_for(files.json)
    print_lines(console, study.remarks)
    tables = results.clusters_table, results.orders_table, results.members_table
    for table in tables:
        print_table(console, table(study))
    print_lines(console, results.study_lines(study))
    say(console, *written)
