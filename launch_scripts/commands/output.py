"""What commands print and write: lines, a progress bar, pages, JSON."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import BinaryIO, TypeVar

import msgspec
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)

from bus_schemas.printable import printable
from launch_scripts.commands.options import ResultOptions
from studies.report.result import Result, print_result
from studies.tables import console_for

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


def say(console: Console, *lines: str) -> None:
    """Print lines as they are."""
    for line in lines:
        console.print(printable(line), highlight=False, markup=False, soft_wrap=True)


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[float], None]]:
    """Show in a terminal how far something has come; give a function to say so, from 0 to 1."""
    with _progress(description) as progress:
        task = progress.add_task(description, total=1.0)
        yield lambda share: progress.update(task, completed=share)


def shared(
    function: Callable[[Item], Outcome],
    items: Sequence[Item],
    workers: int,
    description: str,
    scheduler: str | None = None,
) -> list[Outcome]:
    """Apply a function to each item in a pool of processes, or on a Dask cluster.

    Returns the results in the order of the items; shows in a terminal how many are done.
    """
    from studies.workers import share_over_cluster, share_work

    with _progress(description, MofNCompleteColumn()) as progress:
        task = progress.add_task(description, total=len(items))
        done = partial(progress.advance, task)
        if scheduler is not None:
            return share_over_cluster(function, items, scheduler, done)
        return share_work(function, items, workers, done)


def _progress(description: str, *columns: MofNCompleteColumn) -> Progress:
    console = Console(stderr=True)
    return Progress(
        *(TextColumn(description, markup=False), BarColumn(), *columns, TimeRemainingColumn()),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def publish(result: Result, files: ResultOptions, default: Path | str, *more: str) -> None:
    """Write a result as JSON and as a page, if asked to; then print it, and `more` lines.

    The files come first, since a pipe such as `| head` may close before the end of the tables. If a
    file cannot be written, the tables are still printed.
    """
    try:
        write_json(result.document, files.json)
        if files.report is not None:
            from studies.report.page import html_page

            path = Path(files.report or default)
            path.parent.mkdir(parents=True, exist_ok=True)
            _write(html_page(result).encode(), path)
            more += (f"report: {path}",)
    finally:
        console = console_for(files.json)
        print_result(console, result)
        say(console, *more)


def write_json(content: object, destination: str | None) -> None:
    """Write a command's result where `--json` says: a file, `-` for standard output, or nowhere."""
    if destination is None:
        return
    document = msgspec.json.format(msgspec.json.encode(content), indent=1) + b"\n"
    if destination == "-":
        sys.stdout.write(document.decode())
    else:
        _write(document, Path(destination))


@contextmanager
def json_rows(destination: str | None) -> Iterator[Callable[[object], None]]:
    """Give a function that adds a row to the list for `--json`, which so needs no memory."""
    from recordings.read.whole_file import whole_file

    if destination is None:
        yield lambda row: None
        return
    place: AbstractContextManager[BinaryIO] = nullcontext(sys.stdout.buffer)
    if destination != "-":
        place = whole_file(Path(destination))
    with place as file:
        rows = 0

        def add(row: object) -> None:
            nonlocal rows
            file.write((b",\n" if rows else b"[\n") + msgspec.json.encode(row))
            rows += 1

        yield add
        file.write(b"\n]\n" if rows else b"[]\n")
        file.flush()


def _write(content: bytes, path: Path) -> None:
    from recordings.read.whole_file import whole_file

    with whole_file(path) as file:
        file.write(content)
