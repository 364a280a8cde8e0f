"""An HTML page of text, tables and figures, with all that it needs inside the one file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple, TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from studies.report.style import ReportFigure
from studies.tables import Table

Content: TypeAlias = Table | ReportFigure

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


def html_page(
    title: str,
    paragraphs: Sequence[str],
    content: Sequence[Content],
    *,
    verdict: tuple[bool, str] | None = None,
) -> str:
    """Return an HTML document: heading, verdict, text, contents, then tables and figures, numbered.

    Plotly's JavaScript stands in it once. The data of a figure are a JSON script element of their
    own, `ANCHOR-plot-data`, with Plotly's `data` and `layout`.

    `verdict` says whether the run passed, and a line about it, which stands first.
    """
    return _TEMPLATES.get_template("page.html.j2").render(
        title=title,
        paragraphs=paragraphs,
        verdict=verdict,
        sections=list(_sections(content)),
        plotly=Markup(get_plotlyjs()),
    )


def _sections(content: Sequence[Content]) -> Iterator[_Section]:
    tables = figures = 0
    for one in content:
        if isinstance(one, Table):
            tables += 1
            parts = one.parts(_WIDTH)
            small = len(one.parts(_SMALL)) > len(parts) or len(parts) > 1
            heading = f"Table {tables}. {one.title}"
            yield _Section(f"table-{tables}", heading, parts, small)
        else:
            figures += 1
            # Only "<" could end a script element, or begin a comment.
            data = Markup(one.figure.to_json().replace("<", "\\u003c"))
            yield _Section(one.anchor, f"Figure {figures}. {one.heading}", figure=one, data=data)
