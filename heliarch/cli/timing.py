"""`heliarch timing`: whether a plant meets its deadlines in real time, and by how much."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from bus_schemas.errors import InputError
from heliarch.cli.boundary import FAILED, INTERRUPTED, OK
from heliarch.cli.junit import Case, check_junit, write_junit
from heliarch.cli.options import (
    FileOptions,
    Given,
    Junit,
    PageOptions,
    Settings,
    changed_scenario,
    is_run,
    refuse_others,
)
from heliarch.cli.output import Output, publish
from scenarios.run_options import PlantOptions, ProcessOptions, RunOptions, TimeOptions

if TYPE_CHECKING:
    from results.timing.report import Budget, TimingReport


def timing(
    scenario: str = "oahu",
    /,
    *,
    rate: Annotated[str, Parameter(metavar="RATE")] = "1",
    plant: PlantOptions = PlantOptions(),
    settings: Settings = None,
    span: TimeOptions = TimeOptions(),
    machine: ProcessOptions = ProcessOptions(),
    page: PageOptions = PageOptions(),
    files: FileOptions = FileOptions(),
    by: Literal["tier", "agent", "link"] = "tier",
    stages: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    junit: Junit = None,
    given: Given = frozenset(),
) -> int:
    """Run a plant in real time and report whether it meets deadlines.

    For every tier, and by how much.

    Given a recorded run instead of a scenario, report on that. --report writes timing.html into the
    run's folder by default.

    Exit status 1: a budget was not kept, or the run failed. A scenario states its own budgets in
    its table timing.budgets; see docs/timing.md.

    Example: `heliarch timing oahu --rate 20 --duration 60s --report`

    Parameters
    ----------
    scenario
        A shipped scenario or a TOML file; or the folder or run.mcap of a real-time run, to report
        on it without a new run.
    rate
        Cycles a second; or a range (1..200, auto) in which to find the highest rate that the plant
        keeps up with. A run takes 60 s, or 15 s at each rate of a range, and 120 cycles at least,
        unless --to or --duration says otherwise.
    by
        Rows of the tables; the page of --report and --json have all.
    stages
        Write the table of stages that all figures come from: FILE.csv or FILE.parquet.
    """
    from heliarch.cli.live_view import PlainView
    from heliarch.cli.run import page_beside
    from launch_scripts.run_folder import new_run_id, run_folder
    from results.timing.report import report_on
    from studies.timing import measured_run, parse_rates, prepare_at, sweep, sweep_result

    check_junit(junit)
    if stages is not None and stages.suffix not in {".csv", ".parquet"}:
        raise InputError(f"--stages: expected a name with .csv or .parquet, got {stages}")
    output = Output(files.json)
    if is_run(path := Path(scenario)):
        known = {"--report", "--json", "--junit", "--by", "--stages"}
        why = f"expected only {', '.join(sorted(known))} with the recorded run {path}"
        refuse_others(given, known, why)
        return _publish(report_on(path), path, files, by, stages, junit)
    lowest_hz, highest_hz = parse_rates(rate)
    if stages is not None and lowest_hz != highest_hz:
        raise InputError("--stages: expected one rate with it")
    file = changed_scenario(scenario, files.data, settings)
    options = RunOptions.of(span, plant, machine)
    view = partial(PlainView, output.console)
    with page_beside(page, output) as shown:
        if lowest_hz == highest_hz:
            preparation, place = prepare_at(lowest_hz, 60.0, file, options, files.out)
            if shown is not None:
                output.say(f"page: {shown.show(place.path)}")
            return _publish(
                measured_run(preparation, place, view), place.path, files, by, stages, junit
            )
        folder = run_folder(f"{new_run_id('timing')}-rates", files.out).path

        def timed(rate_hz: float) -> TimingReport:
            name = f"rate-{rate_hz:g}"
            if (folder / name).exists():
                name = f"{name}-again"
            return measured_run(*prepare_at(rate_hz, 15.0, file, options, folder / name), view)

        if shown is not None:
            output.say(f"page: {shown.show(folder, several=True)}")
        rates = sweep(lowest_hz, highest_hz, timed)
    result = sweep_result(rates, file.scenario.name)
    publish(result, files, folder / "timing.html", f"recordings: {folder}")
    if any(row.outcome == "interrupted" for row in rates):
        return INTERRUPTED
    return OK if result.verdict and result.verdict[0] else FAILED


def _publish(
    report: TimingReport,
    run: Path,
    files: FileOptions,
    by: str,
    stages: Path | None,
    junit: Path | None,
) -> int:
    from recordings.read.run_file import RECORDING_NAME
    from results.timing.results import timing_result

    recording = run / RECORDING_NAME if run.is_dir() else run
    page = recording.with_name("timing.html")
    if stages is not None:
        write = report.stages.to_csv if stages.suffix == ".csv" else report.stages.to_parquet
        write(stages, index=False)
    write_junit(junit, {f"timing of {report.run.run_id}": map(_case, report.budgets)})
    publish(timing_result(report, by), files, page, f"recording: {recording}")
    if report.run.interrupted:
        return INTERRUPTED
    return OK if report.passed else FAILED


def _case(budget: Budget) -> Case:
    measured = "nothing was measured" if budget.value is None else f"{budget.value:.6g}"
    text = f"{measured} {budget.unit}, at most {budget.limit:g} {budget.unit}"
    return Case(budget.line, "" if budget.passed else text)
