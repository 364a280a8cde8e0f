"""`heliarch clusters`: what virtual neighbours are worth beside other ways to choose clusters."""

from __future__ import annotations

from typing import Annotated, Final

import typer

from launch_scripts.commands.options import (
    DataOption,
    DurationOption,
    EndOption,
    JsonOption,
    ScenarioArgument,
    SchemeOption,
    SettingsOption,
    StartOption,
    WorkersOption,
)
from launch_scripts.commands.output import counted, say, write_json
from studies.tables import console_for, print_table

EXAMPLE: Final = "heliarch clusters oahu --random 50 --periods 1,30"


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
    json: JsonOption = None,
) -> None:
    """Compare virtual neighbours with geographic and random clusters."""
    from bus_schemas.times import parse_duration_s
    from launch_scripts.scenarios.preparation import RunOptions, prepare
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.clusters.study import (
        ClusterQuestion,
        central_periods,
        clusters_table,
        study_clusters,
        study_json,
        study_lines,
    )
    from studies.clusters.worth import by_first_part, by_scenario
    from studies.compare.cases import with_settings
    from studies.compare.study import remarks_of

    console = console_for(json)
    changed = with_settings(load_scenario(scenario, data), settings or ())
    options = RunOptions(start, duration, scheme=scheme, end=end)
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
    # The file first: whoever reads the table may leave before its end.
    write_json(study_json(study), json)
    say(console, *study.remarks)
    print_table(console, clusters_table(study))
    say(console, *study_lines(study))
