"""The study of delay and loss as tables, lines of text and an HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile
from typing import Final, get_args

from plotly.subplots import make_subplots
from rich.console import Console

from agents.settings import Scheme
from launch_scripts.scenarios.preparation import Preparation
from studies.compare.study import remarks_of
from studies.delays.study import VALUES, WARM_UP_S, Outcome, Trouble, counted_s
from studies.metrics.figures_of_merit import FIGURES_OF_MERIT, shown_in
from studies.report.page import html_page
from studies.report.style import SCHEMES, ReportFigure, dress, marked_line
from studies.tables import Column, Table, key_column, print_lines, print_table

BEARABLE_PERCENT: Final = 1.0
"""Control-caused shortfall and over-delivery, in % of desired, below which it is survived."""

TROUBLES: Final[dict[Trouble, tuple[str, str, str]]] = {
    "delay": ("Every hop delayed", "delay of each hop", "s"),
    "loss": ("A share of all messages lost", "lost messages", "%"),
    "period": ("A slow central controller", "central period", "s"),
}
"""Title of each trouble, what measures it, and its unit."""

_LEGEND: Final = (
    "absent: inputs that had not come at their deadline, in % of all",
    "old inputs: older messages used in their place",
    f"the first {WARM_UP_S:g} s of each run do not count",
)

_DRAWN: Final = ("control-caused", "over-delivered", "mileage", "regd", "score")
_CAPTION: Final = (
    "Along each panel one thing is worse than in the scenario, in even steps from nothing to very "
    "bad; everything else is perfect."
)
_ROW_PX: Final = 240
_GAP_PX: Final = 60
_FRAME_PX: Final = 120


def print_study(preparation: Preparation, outcomes: Sequence[Outcome], console: Console) -> None:
    """Print the tables, and how much of each trouble is survived."""
    print_lines(console, [preparation.title(), *study_notes(preparation), ""])
    for trouble in VALUES:
        print_table(console, trouble_table(trouble, outcomes))
    print_lines(console, survived(outcomes))


def study_notes(preparation: Preparation) -> tuple[str, ...]:
    """Say what a reader of the tables must know."""
    notes = (*remarks_of(preparation), *_LEGEND)
    counted = counted_s(preparation.plan)
    if counted / 2.0 >= max(VALUES["period"]):
        return notes
    return (
        *notes,
        f"central periods above {counted / 2.0:g} s are left out: the {counted:g} s that count do "
        "not hold two of them",
    )


def column_of(outcomes: Sequence[Outcome], trouble: Trouble, scheme: str) -> list[Outcome]:
    """Return the outcomes of a scheme under a growing trouble."""
    return [one for one in outcomes if (one.trouble, one.scheme) == (trouble, scheme)]


def survived(outcomes: Sequence[Outcome]) -> list[str]:
    """Say, for each scheme, up to where each trouble costs less than 1 % either way."""
    lines = []
    for scheme in get_args(Scheme):
        limits = []
        for trouble, (_, measure, unit) in TROUBLES.items():
            column = column_of(outcomes, trouble, scheme)
            bearable = [one.value for one in takewhile(_is_bearable, column)]
            limits.append(
                f"{measure} up to {bearable[-1]:g} {unit}" if bearable else f"no {measure}"
            )
        lines.append(
            f"{scheme}: the shortfall that control causes and the over-delivery both stay below "
            f"{BEARABLE_PERCENT:g} % of the desired energy at {', '.join(limits)}"
        )
    return lines


def _is_bearable(one: Outcome) -> bool:
    percents = (one.figures["control-caused"], one.figures["over-delivered"])
    return all(percent is not None and percent < BEARABLE_PERCENT for percent in percents)


def trouble_table(trouble: Trouble, outcomes: Sequence[Outcome]) -> Table:
    title, measure, unit = TROUBLES[trouble]
    figures = [figure for figure in shown_in("delays") if _has_value(figure.name, outcomes)]
    columns = (
        key_column(f"{measure} [{unit}]", "value"),
        key_column("scheme"),
        *(figure.column for figure in figures),
        Column("absent", "%", 1, name="missed_percent"),
        Column("old inputs", name="old_inputs"),
    )
    rows = [
        (
            f"{one.value:g}",
            one.scheme,
            *(one.figures[figure.name] for figure in figures),
            one.missed_percent,
            one.old_inputs,
        )
        for one in outcomes
        if one.trouble == trouble
    ]
    return Table(title, columns, rows)


def _has_value(merit: str, outcomes: Sequence[Outcome]) -> bool:
    """Whether any run has this figure of merit: without regulation some have no value."""
    return any(one.figures[merit] is not None for one in outcomes)


def study_page(preparation: Preparation, outcomes: Sequence[Outcome]) -> str:
    title = f"{preparation.title()}: delay, loss and a slow central controller"
    notes = [*study_notes(preparation), *survived(outcomes)]
    tables = [trouble_table(trouble, outcomes) for trouble in VALUES]
    return html_page(title, notes, [_study_figure(outcomes), *tables])


def _study_figure(outcomes: Sequence[Outcome]) -> ReportFigure:
    """Draw a panel for each figure of merit and each trouble, in even steps of the trouble."""
    drawn = [merit for merit in _DRAWN if _has_value(merit, outcomes)]
    figure = make_subplots(
        len(drawn),
        len(TROUBLES),
        shared_yaxes=True,
        vertical_spacing=_GAP_PX / (_ROW_PX * len(drawn)),
        horizontal_spacing=0.03,
    )
    for row, merit in enumerate(drawn, start=1):
        for column, (trouble, (_, measure, unit)) in enumerate(TROUBLES.items(), start=1):
            for colour, scheme in zip(SCHEMES, get_args(Scheme), strict=False):
                found = column_of(outcomes, trouble, scheme)
                line = marked_line(
                    list(range(len(found))),
                    [one.figures[merit] for one in found],
                    scheme,
                    colour,
                    showlegend=row == column == 1,
                    customdata=[one.value for one in found],
                    hovertemplate="%{customdata:g}: %{y:.4g}<extra>" + scheme + "</extra>",
                )
                figure.add_trace(line, row, column)
            figure.update_xaxes(
                row=row,
                col=column,
                tickvals=list(range(len(found))),
                ticktext=[f"{one.value:g}" for one in found],
                title_text=f"{measure} [{unit}]" if row == len(drawn) else None,
            )
        figure.update_yaxes(row=row, col=1, title_text=FIGURES_OF_MERIT[merit].heading)
    figure = dress(figure, _FRAME_PX + _ROW_PX * len(drawn))
    return ReportFigure("study", "What each trouble costs", _CAPTION, figure)
