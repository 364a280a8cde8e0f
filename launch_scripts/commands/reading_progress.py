"""A bar for long reading, in a terminal alone: nothing of it reaches a file or a pipe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def reading_progress(description: str) -> Iterator[Callable[[float], None]]:
    """Show how far something has come; give a function to say so, from 0 to 1."""
    console = Console(stderr=True)
    columns = (TextColumn(description), BarColumn(), TimeRemainingColumn())
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(description, total=1.0)
        yield lambda share: progress.update(task, completed=share)
