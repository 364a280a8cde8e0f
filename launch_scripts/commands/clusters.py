"""`heliarch clusters`: what virtual neighbours are worth beside other ways to choose clusters."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from launch_scripts.commands.options import (
    DataOption,
    DurationOption,
    EndOption,
    JsonOption,
    ReportOption,
    ScenarioArgument,
    SchemeOption,
    SeedOption,
    SettingsOption,
    StartOption,
    WorkersOption,
)
from launch_scripts.commands.output import counted, say, write_json, write_page
from studies.tables import console_for, print_lines, print_table

EXAMPLE: Final = "heliarch clusters oahu --random 50 --periods 1,30 --report"
PAGE_NAME: Final = "clusters.html"


def clusters(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    end: EndOption = None,
    duration: DurationOption = None,
    periods: Annotated[
        str | None,
        typer.Option(
            help="How often the central controller acts, seconds; default 1,10,60 as the cycle "
            "allows.",
            metavar="SECONDS",
        ),
    ] = None,
    random: Annotated[
        int, typer.Option(min=1, max=1000, help="How many random choices of clusters to try.")
    ] = 20,
    seed: SeedOption = None,
    scheme: SchemeOption = None,
    learn: Annotated[
        str | None,
        typer.Option(
            help="Choose clusters from a first part of the run, of this length; run the rest.",
            metavar="TIME",
        ),
    ] = None,
    settings: SettingsOption = None,
    workers: WorkersOption = 1,
    data: DataOption = None,
    report: ReportOption = None,
    json: JsonOption = None,
) -> None:
    """Compare virtual neighbours with geographic and random clusters.

    --report writes clusters.html by default.
    """
    from bus_schemas.times import parse_duration_s
    from launch_scripts.scenarios.preparation import RunOptions, prepare
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.clusters.results import (
        clusters_table,
        members_table,
        orders_table,
        study_json,
        study_lines,
        study_page,
    )
    from studies.clusters.study import ClusterQuestion, central_periods, study_clusters
    from studies.clusters.worth import by_first_part, by_scenario
    from studies.compare.cases import with_settings
    from studies.compare.study import remarks_of

    console = console_for(json)
    changed = with_settings(load_scenario(scenario, data), settings or ())
    options = RunOptions(start, duration, seed=seed, scheme=scheme, end=end)
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
    central = central_periods(periods, plan)
    question = ClusterQuestion(arrange, control, inverters, plan.scheme, central, random)
    study = study_clusters(
        question, remarks, workers, lambda done, total: counted(done, "clusters", total, console)
    )
    # Files first: whoever reads the table may leave before its end.
    write_json(study_json(study), json)
    page = Path(report or PAGE_NAME)
    if report is not None:
        write_page(study_page(study), page)
    print_lines(console, study.remarks)
    for table in (clusters_table(study), orders_table(study), members_table(study)):
        print_table(console, table)
    print_lines(console, study_lines(study))
    if report is not None:
        say(console, f"report: {page}")
