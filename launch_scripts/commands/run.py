"""What `launch`, `simulate` and the Python API share: a run from its request to its summary."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TypeAlias

import msgspec
from rich.console import Console

from bus_schemas.errors import FailureError, InputError
from launch_scripts.commands.boundary import FAILED, INTERRUPTED, OK, complain
from launch_scripts.commands.output import say, write_json
from launch_scripts.launcher.launch import launch
from launch_scripts.launcher.live_view import View, view_for
from launch_scripts.launcher.request import RunRequest, prepare_run
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.simulation import simulate
from launch_scripts.launcher.summary import RunSummary
from launch_scripts.launcher.summary_table import print_summary
from launch_scripts.launcher.supervision import ForkServerProcess, RunFailure
from launch_scripts.scenarios.preparation import Preparation
from live_page.process import PageProcess
from studies.report.recorded_run import write_run_report
from studies.tables import console_for

Driver: TypeAlias = Callable[[Preparation, RunFolder, View, float], RunSummary]


@contextmanager
def page_process(
    wanted: bool, address: str | None, port: int | None
) -> Iterator[PageProcess | None]:
    """Start the page of a run if it is wanted, before anything else is done."""
    if wanted:
        with PageProcess(address, port) as page:
            yield page
        return
    for option, given in (("--page-address", address), ("--page-port", port)):
        if given is not None:
            raise InputError(f"{option}: expected --page with it")
    yield None


def run_and_print(
    request: RunRequest,
    json: str | None,
    report: str | None,
    began_at: float,
    page: PageProcess | None = None,
) -> int:
    """Run what was asked for and print its result. Returns the exit status.

    Parameters
    ----------
    request
        What to run.
    json, report
        Values of the options.
    began_at
        Monotonic time at which the command began [s].
    page
        Shows the run until nobody looks at it any more.
    """
    console = console_for(json)
    summary, folder = run(request, console, began_at, page)
    if json is not None:
        write_json(msgspec.Raw(summary.as_json()), json)
    print_summary(summary, console)
    say(console, f"recording: {folder.recording}")
    if report is not None and summary.cycles:
        say(console, f"report: {write_run_report(folder.path, Path(report) if report else None)}")
    if page is not None:
        page.let_end(partial(say, console))
    if summary.recording_ended:
        return complain(f"{summary.recording_ended}; what it holds can be read", FAILED)
    if summary.lost_by_processes:
        return complain(_lost_text(summary), FAILED)
    return INTERRUPTED if summary.interrupted else OK


def run(
    request: RunRequest, console: Console, began_at: float, page: PageProcess | None = None
) -> tuple[RunSummary, RunFolder]:
    """Run a plant, recorded, and write its summary; show it meanwhile.

    Raises
    ------
    InputError
        Scenario, options and data do not go together.
    FailureError
        The run could not go on.
    """
    with ExitStack() as stack:
        driver: Driver = simulate
        if request.driver == "launch":
            # It imports what the processes need while the run is worked out.
            driver = partial(launch, server=stack.enter_context(ForkServerProcess()))
        preparation, folder = prepare_run(request)
        scenario = preparation.scenario.scenario
        try:
            with view_for(console, preparation.plan, scenario.time.timezone) as view:
                for line in (scenario.title, *preparation.remarks):
                    view.say(line)
                if page is not None:
                    view.say(f"page: {page.show(folder.path)}")
                summary = driver(preparation, folder, view, began_at)
        except RunFailure as failure:
            if not folder.recording.exists():
                raise
            raise FailureError(f"{failure}\nrecording up to there: {folder.recording}") from failure
    folder.summary.write_bytes(summary.as_json() + b"\n")
    return summary, folder


def _lost_text(summary: RunSummary) -> str:
    lines = [
        f"{count.signal}: {count.published:,} published, {count.recorded:,} recorded"
        for count in summary.messages
        if count.lost
    ]
    return "messages were lost: " + "; ".join(lines)
