"""Marks in the figures over time: where faults, orders, restarts and absences of a run are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import plotly.graph_objects as go

from recordings.inspect.agent_states import fault_changes
from recordings.inspect.overview import Overview
from recordings.read.reader import RunReader
from recordings.read.series import RunSeries
from results.report import style
from sim_plant.orders import order_text

_MOST: Final = 60


class Mark(NamedTuple):
    """Something that happened in a cycle."""

    cycle: int
    text: str
    colour: str


def run_marks(reader: RunReader, overview: Overview, series: RunSeries) -> list[Mark]:
    """Return the marks of a run in the order of time; of many absences the first ones alone."""
    return sorted([*_marks(reader, overview, series)][:_MOST])


def _marks(reader: RunReader, overview: Overview, series: RunSeries) -> Iterator[Mark]:
    for change in fault_changes(reader.plan):
        if change.cycle <= reader.last_cycle:
            yield Mark(change.cycle, f"fault {change.text}", style.ORANGE)
    for dispatch in series.orders:
        text = f"{dispatch.order_source}: {order_text(dispatch)}"
        yield Mark(dispatch.cycle, text, style.BLUE)
    for span in overview.states:
        if span.cycles:
            text = f"{span.agent}: {span.what()} for {span.cycles:,} cycles"
            yield Mark(span.first_cycle, text, style.VERMILLION)
        if span.back_in is not None:
            yield Mark(span.back_in, f"{span.agent}: {span.return_text()}", style.GREEN)


def mark(figure: go.Figure, series: RunSeries, marks: Sequence[Mark]) -> None:
    """Draw a line at each mark through all panels, with its text to be pointed at."""
    times_ms = style.clock_ms(series)
    for one in (one for one in marks if one.cycle < series.cycles):
        line = {"color": one.colour, "width": 1, "dash": "dot"}
        figure.add_vline(x=times_ms[one.cycle], line=line)
        figure.add_annotation(
            x=times_ms[one.cycle],
            y=1,
            yref="y domain",
            yanchor="middle",
            text="▼",
            font={"color": one.colour, "size": 11},
            showarrow=False,
            hovertext=style.plain(one.text),
        )
