"""An HTML page of text, tables and figures, with all that it needs inside the one file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from results.report.result import Result

_WIDTH: Final = 96
"""Characters that fit into a line of a page 1,050 px wide."""

_PLOTLY: Final = Path(__file__).with_name("templates") / "plotly-cartesian.min.js"
"""Plotly for plain axes, a third of the library, in the version that its package writes for."""

_TEMPLATES: Final = Environment(
    loader=PackageLoader("results.report", "templates"),
    autoescape=True,
    trim_blocks=True,
    lstrip_blocks=True,
    undefined=StrictUndefined,
)


def html_page(result: Result) -> str:
    """Return an HTML document: heading, verdict, text, contents, figures and tables, numbered.

    It contains Plotly's JavaScript once. The data of each figure are in a JSON script element,
    `ANCHOR-plot-data`, with Plotly's `data` and `layout`.
    """
    return _TEMPLATES.get_template("page.html.j2").render(
        result=result,
        figures=result.figures(),
        tables=[*result.tables, *result.details],
        width=_WIDTH,
        plotly=Markup(_PLOTLY.read_text(encoding="utf-8")),
    )
