"""The result of a command: one model for terminal, JSON and page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from rich.console import Console
from rich.text import Text

from bus_schemas.errors import printable
from results.tables import WIDTH, Table, print_table

if TYPE_CHECKING:
    from results.report.moments import Moment
    from results.report.style import ReportFigure


class KeyFigure(NamedTuple):
    """A number that the page of a run shows large, with what it means."""

    value: str
    title: str
    note: str


@dataclass(frozen=True, slots=True)
class Result:
    """The result of a command, printed, written as JSON, and drawn as a page.

    title: Heading of the page.
    document: Content of the JSON.
    lines: What a reader must know before the tables; `conclusions`: what follows from them.
    verdict: Whether all is well, and a line that says so.
    figures, details: Draws the figures; further tables. Only the page has them.
    headline, key_figures, moments: What the page of a run shows first, with its first figure.
    links: Texts and addresses of the pages that lead here, of a page that is served.
    """

    title: str
    tables: Sequence[Table]
    document: object
    lines: Sequence[str] = ()
    conclusions: Sequence[str] = ()
    verdict: tuple[bool, str] | None = None
    figures: Callable[[], Sequence[ReportFigure]] = tuple
    details: Sequence[Table] = ()
    headline: str = ""
    key_figures: Sequence[KeyFigure] = ()
    moments: Sequence[Moment] = ()
    links: Sequence[tuple[str, str]] = ()


def print_result(console: Console, result: Result) -> None:
    """Print a result: its lines and tables, what follows from them, and the verdict."""
    _print_lines(console, result.lines)
    for table in result.tables:
        print_table(console, table)
    _print_lines(console, result.conclusions)
    if result.verdict is not None:
        passed, text = result.verdict
        console.print(Text(printable(text), "green" if passed else "bold red"))


def _print_lines(console: Console, lines: Sequence[str]) -> None:
    """Print paragraphs of plain text, wrapped as tables are."""
    for line in lines:
        console.print(Text(printable(line)), width=min(console.width, WIDTH))
    console.print("\n" * bool(lines), end="")
