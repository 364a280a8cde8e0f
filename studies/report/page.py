"""An HTML page of text, tables and figures, with all that it needs inside the one file."""

from __future__ import annotations

import html
from collections.abc import Sequence
from importlib import resources
from typing import Final

from plotly.offline import get_plotlyjs

from studies.report.style import ReportFigure
from studies.report.tables import ReportTable

# The page asks for nothing from anywhere: a browser refuses even what would try.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)


_NARROW: Final = 4
"""Tables of more runs than that are set smaller."""


def html_page(
    title: str,
    paragraphs: Sequence[str],
    tables: Sequence[ReportTable],
    figures: Sequence[ReportFigure],
) -> str:
    """Return an HTML document: heading, text, contents, then tables and figures, each numbered.

    Plotly's JavaScript stands in it once. The data of a figure are a JSON script element of their
    own, `ANCHOR-plot-data`, with Plotly's `data` and `layout`.

    Parameters
    ----------
    title
        Heading, plain text.
    paragraphs
        Text below the heading, plain text.
    tables, figures
        What to show, in this order. The figures' anchors must differ.
    """
    numbered_tables = [
        (f"table-{number}", f"Table {number}. {table.heading}", table)
        for number, table in enumerate(tables, start=1)
    ]
    numbered_figures = [
        (figure.anchor, f"Figure {number}. {figure.heading}", figure)
        for number, figure in enumerate(figures, start=1)
    ]
    contents = [
        f'<li><a href="#{anchor}">{html.escape(heading)}</a></li>'
        for anchor, heading, _ in [*numbered_tables, *numbered_figures]
    ]
    lines = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        *_head(title),
        "<body>",
        "<header>",
        f"<h1>{html.escape(title)}</h1>",
        *(f"<p>{html.escape(text)}</p>" for text in paragraphs),
        "<noscript><p>The figures need JavaScript, the tables do not.</p></noscript>",
        "</header>",
        '<nav aria-label="Contents">',
        "<ul>",
        *contents,
        "</ul>",
        "</nav>",
        "<main>",
        *(_table(*entry) for entry in numbered_tables),
        *(_figure(*entry) for entry in numbered_figures),
        "</main>",
        f"<script>{get_plotlyjs()}</script>",
        f"<script>\n{_part('page.js')}</script>",
        "</body>",
        "</html>",
        "",
    ]
    return "\n".join(lines)


def _head(title: str) -> list[str]:
    return [
        "<head>",
        '<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{html.escape(title)}</title>",
        f"<style>\n{_part('page.css')}</style>",
        "</head>",
    ]


def _table(anchor: str, heading: str, table: ReportTable) -> str:
    columns = "".join(
        f'<th scope="col" class="number">{html.escape(column)}</th>' for column in table.columns
    )
    rows = "\n".join(
        f'<tr><th scope="row">{html.escape(name)}</th><td class="unit">{html.escape(unit)}</td>'
        + "".join(f'<td class="number">{html.escape(value)}</td>' for value in values)
        + "</tr>"
        for name, unit, values in table.rows
    )
    wide = ' class="wide"' if len(table.columns) > _NARROW else ""
    note = f'<p class="note">{html.escape(table.note)}</p>\n' if table.note else ""
    return (
        f'<section id="{anchor}">\n<h2>{html.escape(heading)}</h2>\n'
        f'<div class="scroll"><table{wide}>\n'
        f"<thead><tr><th></th><th></th>{columns}</tr></thead>\n"
        f"<tbody>\n{rows}\n</tbody>\n</table></div>\n{note}</section>"
    )


def _figure(anchor: str, heading: str, figure: ReportFigure) -> str:
    height_px = figure.figure.layout.height
    # Within a script element only "<" could end it, or begin a comment.
    data = figure.figure.to_json().replace("<", "\\u003c")
    return (
        f'<section id="{anchor}">\n<h2>{html.escape(heading)}</h2>\n<figure>\n'
        f'<div class="plot" id="{anchor}-plot" style="height: {height_px}px"></div>\n'
        f"<figcaption>{html.escape(figure.caption)}</figcaption>\n</figure>\n"
        f'<script type="application/json" id="{anchor}-plot-data">{data}</script>\n</section>'
    )


def _part(name: str) -> str:
    return resources.files("recordings.report").joinpath(name).read_text(encoding="utf-8")
