"""What commands print and write: the console, lines, a progress bar, JSON."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TypeVar

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

Item = TypeVar("Item")


def say(console: Console, *lines: str) -> None:
    """Print lines as they are."""
    for line in lines:
        console.print(printable(line), highlight=False, markup=False, soft_wrap=True)


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[float], None]]:
    """Show in a terminal how far something has come; give a function to say so, from 0 to 1."""
    console = Console(stderr=True)
    columns = (TextColumn(description, markup=False), BarColumn(), TimeRemainingColumn())
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(description, total=1.0)
        yield lambda share: progress.update(task, completed=share)


def counted(
    items: Generator[Item], description: str, total: int, console: Console
) -> Iterator[Item]:
    """Yield items; show in a terminal how many of them are done.

    Whatever ends it ends those who work on the items.
    """
    columns = (TextColumn(description), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with (
        closing(items),
        Progress(
            *columns, console=console, transient=True, disable=not console.is_terminal
        ) as progress,
    ):
        task = progress.add_task(description, total=total)
        for item in items:
            yield item
            progress.advance(task)


def write_page(html: str, path: Path) -> None:
    """Write a page; folders that are missing are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _write(html.encode(), path)


def write_json(content: object, destination: str | None) -> None:
    """Write a command's result where `--json` says: a file, `-` for standard output, or nowhere."""
    if destination is None:
        return
    document = msgspec.json.format(msgspec.json.encode(content), indent=1) + b"\n"
    if destination == "-":
        sys.stdout.write(document.decode())
    else:
        _write(document, Path(destination))


def _write(content: bytes, path: Path) -> None:
    from recordings.read.whole_file import whole_file

    with whole_file(path) as file:
        file.write(content)
