"""An HTML page of text, tables and figures, with all that it needs inside the one file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from studies.report.result import Result
from studies.report.style import ReportFigure
from studies.tables import Table

_WIDTH: Final = 96
"""Characters that fit beside one another where the page is 800 px wide, in the small type."""

_SMALL: Final = 76
"""Tables of more characters than that are set in smaller type."""

_TEMPLATES: Final = Environment(
    loader=PackageLoader("studies.report", "templates"),
    autoescape=True,
    trim_blocks=True,
    lstrip_blocks=True,
    undefined=StrictUndefined,
)


class _Section(NamedTuple):
    """What the template needs: a table in parts, or a figure with its Plotly data and layout."""

    anchor: str
    heading: str
    parts: Sequence[Table] = ()
    small: bool = False
    figure: ReportFigure | None = None
    data: Markup = Markup()


def html_page(result: Result) -> str:
    """Return an HTML document: heading, verdict, text, contents, figures and tables, numbered.

    Plotly's JavaScript stands in it once. The data of a figure are a JSON script element of their
    own, `ANCHOR-plot-data`, with Plotly's `data` and `layout`.
    """
    return _TEMPLATES.get_template("page.html.j2").render(
        title=result.title,
        paragraphs=[*result.lines, *result.conclusions],
        verdict=result.verdict,
        sections=list(_sections(result)),
        plotly=Markup(get_plotlyjs()),
    )


def _sections(result: Result) -> Iterator[_Section]:
    for number, one in enumerate(result.figures(), start=1):
        # Only "<" could end a script element, or begin a comment.
        data = Markup(one.figure.to_json().replace("<", "\\u003c"))
        yield _Section(one.anchor, f"Figure {number}. {one.heading}", figure=one, data=data)
    for number, table in enumerate([*result.tables, *result.details], start=1):
        parts = table.parts(_WIDTH)
        small = len(table.parts(_SMALL)) > len(parts) or len(parts) > 1
        yield _Section(f"table-{number}", f"Table {number}. {table.title}", parts, small)
