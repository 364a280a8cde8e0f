"""What commands print and write: lines, a progress bar, pages, JSON."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
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
from studies.tables import console_for

Item = TypeVar("Item")
Result = TypeVar("Result")


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


def counted(numbered: Generator[tuple[int, Result]], description: str, total: int) -> list[Result]:
    """Return numbered results in order; show in a terminal how many are done.

    Whatever ends it ends those who work on the results.
    """
    found: dict[int, Result] = {}
    with closing(numbered), _progress(description, MofNCompleteColumn()) as progress:
        task = progress.add_task(description, total=total)
        for number, one in numbered:
            found[number] = one
            progress.advance(task)
    return [found[number] for number in sorted(found)]


def shared(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int, description: str
) -> list[Result]:
    """Apply a function to each item in a pool of processes; return the results in their order."""
    from studies.workers import share_work

    return counted(share_work(function, items, workers), description, len(items))


def _progress(description: str, *columns: MofNCompleteColumn) -> Progress:
    console = Console(stderr=True)
    return Progress(
        *(TextColumn(description, markup=False), BarColumn(), *columns, TimeRemainingColumn()),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


@contextmanager
def written(
    document: object, files: ResultOptions, page: Callable[[], str], default: Path | str
) -> Iterator[Console]:
    """Write a result as JSON and as a page, where they are wanted; give the console to print it on.

    The files come first: whoever reads the tables may leave before their end.
    """
    write_json(document, files.json)
    path = Path(files.report or default)
    if files.report is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(page().encode(), path)
    console = console_for(files.json)
    yield console
    if files.report is not None:
        say(console, f"report: {path}")


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
