"""Marks in the figures over time: where faults, orders, restarts and absences of a run are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import plotly.graph_objects as go

from agents.plan import RunPlan
from bus_schemas.messages import Dispatch, Message
from bus_schemas.signals import DISPATCH, Port
from bus_schemas.tree import ROOT
from recordings.inspect.agent_states import fault_changes
from recordings.inspect.health import Health
from recordings.read.reader import RunReader
from recordings.read.series import RunSeries
from results.report import style
from sim_plant.orders import OrderInForce

_MOST: Final = 60


class Mark(NamedTuple):
    """Something that happened in a cycle."""

    cycle: int
    text: str
    colour: str


class OrderMarks:
    """Marks of the operator's orders, from the dispatches that state them."""

    def __init__(self, plan: RunPlan) -> None:
        self.ports = frozenset({DISPATCH.of(ROOT)})
        self.marks: list[Mark] = []
        self._rating_kw = plan.tree.rating_kw(ROOT)
        self._before: OrderInForce | None = None

    def see(self, port: Port[Message], message: Message) -> None:
        assert isinstance(message, Dispatch)
        order = OrderInForce.by(message)
        if order is None or (self._before is not None and order.what == self._before.what):
            return
        self._before = order
        text = f"{order.source}: {order.text(self._rating_kw)}"
        self.marks.append(Mark(message.cycle, text, style.BLUE))


def run_marks(reader: RunReader, health: Health, orders: Sequence[Mark]) -> list[Mark]:
    """Return the marks of a run in the order of time, at most sixty of them."""
    return sorted([*_marks(reader, health), *orders])[:_MOST]


def _marks(reader: RunReader, health: Health) -> Iterator[Mark]:
    for change in fault_changes(reader.plan):
        if change.cycle <= reader.last_cycle:
            yield Mark(change.cycle, f"fault {change.text}", style.ORANGE)
    for absence in health.absences:
        if absence.cycles:
            text = f"{absence.agent}: not heard for {absence.cycles:,} cycles"
            yield Mark(absence.first_cycle, text, style.VERMILLION)
        if absence.back_in is not None:
            yield Mark(absence.back_in, f"{absence.agent}: {absence.how}", style.GREEN)
    for agent, cycle in (health.launcher.given_up if health.launcher else {}).items():
        yield Mark(cycle, f"{agent}: given up", style.VERMILLION)


def mark(figure: go.Figure, series: RunSeries, marks: Sequence[Mark]) -> None:
    """Draw a line at each mark through all panels, with its text to be pointed at."""
    if not marks:
        return
    times_ms = style.clock_ms(series)
    panels = sum(1 for name in figure.layout if name.startswith("yaxis") and figure.layout[name])
    for one in (one for one in marks if one.cycle < series.cycles):
        for panel in range(1, panels + 1):
            number = "" if panel == 1 else str(panel)
            figure.add_shape(
                type="line",
                xref=f"x{number}",
                yref=f"y{number} domain",
                x0=times_ms[one.cycle],
                x1=times_ms[one.cycle],
                y0=0,
                y1=1,
                line={"color": one.colour, "width": 1, "dash": "dot"},
            )
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
