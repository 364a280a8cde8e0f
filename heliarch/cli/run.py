"""What `launch`, `simulate` and the Python API share: a run from its request to its summary."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import msgspec
from rich.console import Console

from bus_schemas.errors import FailureError
from heliarch.cli.boundary import BEGAN_AT, FAILED, INTERRUPTED, OK, complain
from heliarch.cli.live_view import PlainView
from heliarch.cli.options import FileOptions, PageOptions
from heliarch.cli.output import Output, do_all
from launch_scripts.fork_server_process import ForkServer
from launch_scripts.launch import check_processes, run_as_processes
from launch_scripts.run_folder import RunFolder, prepare_run
from launch_scripts.simulation import run_in_one_process
from live_page.process import PageProcess
from results.headline import print_headline
from results.run_document import RunDocument
from results.summary_table import print_summary
from scenarios.run_options import RunOptions
from scenarios.scenario import ScenarioFile


@contextmanager
def page_beside(options: PageOptions, output: Output) -> Iterator[PageProcess | None]:
    """Start the page of a command, if it is wanted; at the end, wait until it is closed."""
    if not options.page:
        yield None
        return
    with PageProcess(options.page_address, options.page_port, orders=options.orders) as page:
        yield page
        page.let_end(output.say)


def run_and_print(
    file: ScenarioFile,
    options: RunOptions,
    files: FileOptions,
    pages: PageOptions,
    server: ForkServer | None = None,
) -> int:
    """Run what was asked for and print its result. Returns the exit status."""
    output = Output(files.json)
    with page_beside(pages, output) as page:
        summary, folder = carry_out(
            file, options, files.out, output.console, BEGAN_AT, server, page
        )
        document = summary.as_json()

        def write_page() -> None:
            if files.report is not None and summary.figures:
                from results.report.run_report import write_run_report  # Plotly imports slowly.

                path = Path(files.report) if files.report else None
                output.say(f"report: {write_run_report(folder.path, path)}")

        do_all(
            partial(folder.write_summary, document),
            partial(output.write, msgspec.Raw(document)),
            partial(print_summary, summary, output.console),
            partial(output.say, f"recording: {folder.recording}"),
            write_page,
            partial(print_headline, summary, output.console),
            partial(output.say, *_what_next(folder.path, files.report is not None)),
        )
        failures = [complain(failure, FAILED) for failure in summary.failures()]
        return max(failures) if failures else INTERRUPTED if summary.interrupted else OK


def _what_next(run: Path, has_report: bool) -> list[str]:
    """Return the commands that a user wants after a run, as they can be typed."""
    if not run.is_dir():  # It has been removed.
        return []
    program = Path(sys.argv[0])
    is_found = shutil.which("heliarch") == str(program.absolute())
    name = "heliarch" if is_found or program.name != "heliarch" else str(program)
    commands = {"view": "watch it again", "inspect": "what it holds"}
    if not has_report:
        commands["report"] = "what it was worth"
    name, folder = shlex.quote(name), shlex.quote(str(run))
    lines = [(f"{name} {command} {folder}", what) for command, what in commands.items()]
    width = max(len(line) for line, _ in lines)
    return ["next:", *(f"  {line:<{width}}   {what}" for line, what in lines)]


def carry_out(
    file: ScenarioFile,
    options: RunOptions,
    out: Path | None,
    console: Console,
    began_at: float,
    server: ForkServer | None = None,
    page: PageProcess | None = None,
) -> tuple[RunDocument, RunFolder]:
    """Run a plant, recorded; show it meanwhile.

    Without a server, which starts the processes, the run stays in this process. `began_at` is the
    monotonic time at which the user asked for it [s].
    """
    # Thousands of inverters take minutes to cluster.
    with Console(stderr=True, force_jupyter=False).status("preparing"):
        preparation, folder = prepare_run(file, options, out)
    if server is not None:
        check_processes(preparation.plan)  # Before anything is printed.
    try:
        with PlainView(console, preparation.plan) as view:
            for line in (preparation.scenario.scenario.title, *preparation.remarks):
                view.say(line)
            if page is not None:
                view.say(f"page: {page.show(folder.path)}")
            if server is None:
                return run_in_one_process(preparation, folder, view, began_at), folder
            return run_as_processes(preparation, folder, view, began_at, server), folder
    except FailureError as failure:
        if not folder.recording.exists():
            raise
        raise FailureError(f"{failure}\nrecording up to there: {folder.recording}") from failure
