"""What `launch` and `simulate` have in common: from the command line's words to an exit status."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import TypeAlias

from rich.console import Console

from bus_schemas.errors import InputError
from launch_scripts.exit_status import BAD_INPUT, FAILED, INTERRUPTED, OK, complain
from launch_scripts.launcher.launch import launch
from launch_scripts.launcher.live_view import View, view_for
from launch_scripts.launcher.request import RunRequest, prepare_run
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.simulation import simulate
from launch_scripts.launcher.summary import RunSummary
from launch_scripts.launcher.summary_table import print_summary
from launch_scripts.launcher.supervision import ForkServerProcess, RunFailure
from launch_scripts.scenarios.preparation import Preparation

Driver: TypeAlias = Callable[[Preparation, RunFolder, View, float], RunSummary]


def run(request: RunRequest, began_at: float) -> int:
    """Prepare and run what was asked for; print what it came to. Returns the exit status.

    Parameters
    ----------
    request
        What the user wants.
    began_at
        Monotonic time at which the command began [s].
    """
    # With the JSON on standard output, nothing else may go there.
    console = Console(stderr=request.json == "-")
    with ExitStack() as stack:
        driver: Driver = simulate
        if request.driver == "launch":
            # It imports what the processes need while the run is worked out.
            driver = partial(launch, server=stack.enter_context(ForkServerProcess()))
        try:
            preparation, folder = prepare_run(request)
        except (OSError, ValueError) as error:
            # Bad input; a file that may not be read, or a name that no file can have.
            return complain(error, BAD_INPUT)
        return _run(request, driver, preparation, folder, console, began_at)


def _run(
    request: RunRequest,
    driver: Driver,
    preparation: Preparation,
    folder: RunFolder,
    console: Console,
    began_at: float,
) -> int:
    try:
        with view_for(
            console, preparation.plan, preparation.scenario.scenario.time.timezone
        ) as view:
            for line in (preparation.scenario.scenario.title, *preparation.remarks):
                view.say(line)
            summary = driver(preparation, folder, view, began_at)
        status = _conclude(summary, folder, request.json, console)
        if request.report and summary.cycles:
            _report(folder, console)
        return status
    except InputError as error:
        return complain(error, BAD_INPUT)
    except OSError as error:
        return complain(f"{error.filename or folder.path}: {error.strerror}", FAILED)
    except RunFailure as error:
        kept = f"recording up to there: {folder.recording}" if folder.recording.exists() else ""
        return complain(f"{error}\n{kept}".strip(), FAILED)
    except KeyboardInterrupt:
        return complain("interrupted; the processes were ended by force", INTERRUPTED)


def _conclude(summary: RunSummary, folder: RunFolder, json: str | None, console: Console) -> int:
    """Print and write what the run came to. Returns the exit status."""
    print_summary(summary, console)
    console.print(f"recording: {folder.recording}", highlight=False, soft_wrap=True, markup=False)
    _write_summary(summary, folder, json)
    if summary.recording_ended:
        return complain(f"{summary.recording_ended}; what it holds can be read", FAILED)
    if summary.lost:
        return complain(_lost_text(summary), FAILED)
    return INTERRUPTED if summary.interrupted else OK


def _report(folder: RunFolder, console: Console) -> None:
    """Write the report of a run that is over; what draws it is not imported before."""
    from launch_scripts.commands.report_work import write_run_report  # noqa: PLC0415

    path = write_run_report(folder.path)
    console.print(f"report: {path}", highlight=False, soft_wrap=True, markup=False)


def _write_summary(summary: RunSummary, folder: RunFolder, json: str | None) -> None:
    document = summary.as_json()
    folder.summary.write_bytes(document + b"\n")
    if json == "-":
        sys.stdout.write(document.decode() + "\n")
    elif json is not None:
        shutil.copyfile(folder.summary, json)


def _lost_text(summary: RunSummary) -> str:
    lines = [
        f"{count.signal}: {count.published:,} published, {count.recorded:,} recorded"
        for count in summary.messages
        if count.lost
    ]
    return "messages were lost: " + "; ".join(lines)
