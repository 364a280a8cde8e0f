"""How the report's figures look: colours, fonts, axes.

The colours are those of Okabe and Ito's palette, which the common kinds of colour blindness tell
apart ("Color Universal Design", 2008, https://jfly.uni-koeln.de/color/).
"""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from recordings.read.series import RunSeries
from results.report.decimation import extremes

BLACK: Final = "#222222"
GREY: Final = "#8a8a8a"
SAND: Final = "#e9cf8f"
BLUE: Final = "#0072b2"
GREEN: Final = "#009e73"
ORANGE: Final = "#e69f00"
VERMILLION: Final = "#d55e00"

SCHEMES: Final = (BLUE, GREEN, "#cc79a7", ORANGE, "#56b4e9")
_DASHES: Final = ("solid", "dash", "dot", "dashdot")

FONT: Final = "system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif"


@dataclass(frozen=True, slots=True, eq=False)
class ReportFigure:
    """A figure and the words that go with it, as plain text.

    `anchor` is the name of its place in the page: letters, digits and hyphens.
    """

    anchor: str
    heading: str
    caption: str
    figure: go.Figure


def scheme_line(position: int) -> dict[str, object]:
    """Return the line of the scheme at a position: colours first, then dashes."""
    return {
        "color": SCHEMES[position % len(SCHEMES)],
        "dash": _DASHES[position // len(SCHEMES) % len(_DASHES)],
        "width": 1.5,
    }


def faint(colour: str, opacity: float = 0.35) -> str:
    """Return a colour of `#rrggbb` as one that lets others through."""
    red, green, blue = (int(colour[at : at + 2], 16) for at in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


def colour_bar(title: str, length_px: int) -> dict[str, object]:
    """Return a colour bar of a length, beside the top of a figure."""
    return {
        "title": {"text": title},
        "len": length_px,
        "lenmode": "pixels",
        "y": 1,
        "yanchor": "top",
        "outlinewidth": 0,
        "thickness": 18,
    }


def plain(text: str) -> str:
    """Return a text that Plotly shows as it is: it takes tags and entities for mark-up."""
    return html.escape(text, quote=False)


def curve(
    x: object, y: object, name: str, line: Mapping[str, object], **look: object
) -> go.Scatter:
    """Return a line; `look` are further properties of a Plotly scatter trace."""
    return go.Scatter(x=x, y=y, mode="lines", name=plain(name), line=line, **look)


def clock_ms(series: RunSeries) -> NDArray[np.float64]:
    """Return the wall clock at the beginning of each cycle, as Plotly's axes count it.

    Plotly knows no time zones: it is given milliseconds since 1970 of a clock that shows local
    time. The clock keeps the offset from UTC of the run's first cycle, so that no hour comes twice
    where summer time ends within a run. Shape (T,).
    """
    first_ms = series.times[0].tz_localize(None).as_unit("ns").value / 1e6
    return np.asarray(first_ms + np.arange(series.cycles) * series.cycle_s * 1e3)


def clock_text(series: RunSeries, cycle: int) -> str:
    """Return the local time of a cycle, with its day where the run has more than one."""
    moment = series.times[cycle]
    several_days = series.times[0].date() != series.times[-1].date()
    return f"{moment.day} {moment:%b %H:%M:%S}" if several_days else f"{moment:%H:%M:%S}"


def time_line(
    series: RunSeries,
    values: NDArray[np.float64],
    name: str,
    line: Mapping[str, object],
    **look: object,
) -> go.Scatter:
    """Return a line of one value a cycle, thinned out for a screen."""
    rows = extremes(values)
    times_ms, kw = clock_ms(series)[rows], values[rows].astype(np.float32)
    return curve(times_ms, kw, name, line, **{"hovertemplate": "%{y:,.1f}", **look})


def dress(figure: go.Figure, height_px: int, *, legend: bool = True) -> go.Figure:
    """Give a figure the report's look."""
    figure.update_layout(
        template="plotly_white",
        height=height_px,
        font={"family": FONT, "size": 13, "color": BLACK},
        margin={"l": 70, "r": 20, "t": 28 if legend else 24, "b": 50},
        hovermode="closest",
        showlegend=legend,
        legend={"orientation": "h", "x": 0, "xanchor": "left", "y": 1, "yanchor": "bottom"},
    )
    figure.update_annotations(font_size=14)
    axis = {
        "ticks": "outside",
        "title": {"standoff": 8, "font": {"size": 13}},
        "automargin": True,
        "separatethousands": True,
        "exponentformat": "none",
    }
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis)
    return figure


def label_time_axis(figure: go.Figure, series: RunSeries, rows: int = 1) -> None:
    """Make the horizontal axes of panels below each other show the time of a run.

    The lowest one says which clock it is, and what all lines show at a time is named together.
    """
    figure.update_layout(hovermode="x")
    times_ms = clock_ms(series)
    end_ms = times_ms[-1] + series.cycle_s * 1e3
    figure.update_xaxes(type="date", range=[times_ms[0], end_ms])
    last = {} if rows == 1 else {"row": rows, "col": 1}
    figure.update_xaxes(title_text=plain(f"local time ({series.times[0]:%Z})"), **last)
