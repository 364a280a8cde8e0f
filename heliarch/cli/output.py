"""What commands print and write: lines, tables, a progress bar, pages, JSON."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import partial
from itertools import count
from pathlib import Path
from typing import BinaryIO, Final, TypeVar

import msgspec
from rich.console import Console
from rich.progress import Progress

from bus_schemas.errors import printable
from bus_schemas.whole_file import whole_file
from heliarch.cli.options import ResultOptions
from results.report.result import Result, print_result
from results.tables import Table, console_for, print_table

_NEXT_LINE_S: Final = 10.0

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


class Output:
    """Where a command's result goes: its console, and what `--json` says: a file, `-` or nothing.

    The console is standard output, or standard error where that gets the JSON.
    """

    def __init__(self, json: str | None = None) -> None:
        self.console = console_for(json)
        self._json = json

    def say(self, *lines: str) -> None:
        for line in lines:
            self.console.print(printable(line), highlight=False, markup=False, soft_wrap=True)

    def show(self, *tables: Table) -> None:
        for table in tables:
            print_table(self.console, table)

    def write(self, document: object) -> None:
        if self._json is not None:
            content = msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n"
            if self._json == "-":
                sys.stdout.write(content.decode())
            else:
                _write(content, Path(self._json))

    def write_rows(self, rows: Iterable[object]) -> None:
        """Take rows one by one, and write them as `write` does a list: they may be a day's."""
        place: AbstractContextManager[BinaryIO] = nullcontext(sys.stdout.buffer)
        if self._json != "-":
            place = whole_file(Path(self._json or os.devnull))
        with place as file:
            file.write(b"[")
            for number, row in enumerate(rows):
                file.write(b",\n" if number else b"\n")
                file.write(msgspec.json.encode(row))
            file.write(b"\n]\n")


@contextmanager
def progress_bar(description: str, total: float = 1.0) -> Iterator[Callable[[float], None]]:
    """Show how far something has come; give a function that says how far.

    Without a terminal, a line every `_NEXT_LINE_S` says so.
    """
    console = Console(stderr=True)
    said_at = time.monotonic()

    def say_share(completed: float) -> None:
        nonlocal said_at
        if time.monotonic() > said_at + _NEXT_LINE_S:
            said_at = time.monotonic()
            console.print(f"{description}: {100.0 * completed / total:.0f} %", highlight=False)

    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(description, total=total)
        if console.is_terminal:
            yield lambda completed: progress.update(task, completed=completed)
        else:
            yield say_share


def shared(
    function: Callable[[Item], Outcome],
    items: Sequence[Item],
    workers: int,
    description: str,
    cluster: str = "",
) -> list[Outcome]:
    """Apply a function to each item in a pool of processes, or in a Dask cluster.

    Returns the results in the order of the items; shows in a terminal how many are done.
    """
    from studies.workers import share_work

    numbers = count(1)
    with progress_bar(description, len(items)) as progress:
        return share_work(function, items, workers, lambda: progress(next(numbers)), cluster)


def publish(result: Result, files: ResultOptions, default: Path | str, *more: str) -> None:
    """Write a result as JSON and as a page, if asked to; then print it, and `more` lines.

    The files come first, since a pipe such as `| head` may close before the end of the tables.
    """
    lines, output = [*more], Output(files.json)

    def write_page() -> None:
        if files.report is not None:
            from results.report.page import html_page

            path = Path(files.report or default)
            path.parent.mkdir(parents=True, exist_ok=True)
            _write(html_page(result).encode(), path)
            lines.append(f"report: {path}")

    do_all(
        partial(output.write, result.document),
        write_page,
        partial(print_result, output.console, result),
        lambda: output.say(*lines),
    )


def do_all(*steps: Callable[[], object]) -> None:
    """Run all steps in order, also those after one that fails; then raise its error."""
    with ExitStack() as stack:
        for step in reversed(steps):
            stack.callback(step)


def _write(content: bytes, path: Path) -> None:
    with whole_file(path) as file:
        file.write(content)
