"""`heliarch clusters`: what virtual neighbours are worth beside other ways to choose clusters."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
from rich.console import Console
from rich.progress import Progress

from agents.plan import Scheme
from bus_schemas.errors import InputError
from launch_scripts.exit_status import BAD_INPUT, FAILED, INTERRUPTED, OK, complain
from launch_scripts.launcher.json_rows import check_json_destination
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario, parse_duration_s
from recordings.read.whole_file import whole_file
from studies.clusters.study import (
    ClusterQuestion,
    ClusterStudy,
    central_periods,
    clusters_table,
    study_clusters,
    study_json,
    study_lines,
)
from studies.clusters.worth import Arrange, by_first_part, by_scenario
from studies.compare.cases import Case, cases, parse_setting
from studies.compare.study import remarks_of
from studies.tables import console_for, print_table
from studies.workers import WorkerLostError, check_workers

_MOST_RANDOM: Final = 1000


@dataclass(frozen=True, slots=True)
class ClustersRequest:
    """The options of the command line, None where the user gave none."""

    scenario: str
    start: str | None
    duration: str | None
    periods: str | None
    random: int
    scheme: Scheme | None
    learn: str | None
    settings: Sequence[str]
    data: Path | None
    json: str | None
    workers: int = 1


def clusters(request: ClustersRequest) -> int:
    """Work out what clusters are worth and print it. Returns the exit status."""
    console = console_for(request.json)
    try:
        study = _study(request, _case(request), console)
        _write(study, request.json)
        for remark in study.remarks:
            console.print(remark, highlight=False)
        print_table(console, clusters_table(study))
        for line in study_lines(study):
            console.print(line, highlight=False)
    except (InputError, ValueError) as error:
        return complain(error, BAD_INPUT)
    except (OSError, WorkerLostError) as error:
        return complain(error, FAILED)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)
    return OK


def _case(request: ClustersRequest) -> Case:
    if not 1 <= request.random <= _MOST_RANDOM:
        raise InputError(f"--random: expected 1 to {_MOST_RANDOM} seeds, got {request.random}")
    check_workers(request.workers)
    check_json_destination(request.json)
    found = cases(
        load_scenario(request.scenario, request.data),
        RunOptions(request.start, request.duration),
        [parse_setting(text) for text in request.settings],
    )
    if len(found) > 1:
        raise InputError(f"--set: expected one value for each field, got {len(found)} cases")
    return found[0]


def _study(request: ClustersRequest, case: Case, console: Console) -> ClusterStudy:
    preparation = prepare(case.scenario, case.options, "clusters")
    plan = preparation.plan
    arrange, remarks = _arrange(request, case, preparation)
    question = ClusterQuestion(
        arrange,
        case.scenario.scenario.control,
        len(plan.inverters),
        request.scheme or plan.scheme,
        central_periods(request.periods, plan),
        request.random,
    )
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("clusters")

        def show(done: int, of: int) -> None:
            progress.update(task, completed=done, total=of)

        return study_clusters(question, remarks, request.workers, show)


def _arrange(
    request: ClustersRequest, case: Case, preparation: Preparation
) -> tuple[Arrange, tuple[str, ...]]:
    """Return how inverters are arranged, and what a reader must know about it."""
    if request.learn is None:
        return by_scenario(case.scenario, case.options), remarks_of(preparation)
    learn_s = parse_duration_s(request.learn, "--learn")
    remark = f"Clusters and neighbours were chosen from the first {learn_s:g} s; the rest was run."
    return by_first_part(preparation, learn_s), (*preparation.remarks, remark)


def _write(study: ClusterStudy, json: str | None) -> None:
    if json is None:
        return
    document = msgspec.json.format(msgspec.json.encode(study_json(study)), indent=1) + b"\n"
    if json == "-":
        sys.stdout.write(document.decode())
        return
    with whole_file(Path(json)) as file:
        file.write(document)
