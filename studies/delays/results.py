"""The result of the study of delay and loss."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile
from typing import Final, get_args

from agents.settings import Scheme
from launch_scripts.scenarios.preparation import Preparation
from studies.compare.study import remarks_of
from studies.delays.study import VALUES, WARM_UP_S, Outcome, Trouble
from studies.metrics.figures_of_merit import FIGURES_OF_MERIT, shown_in
from studies.report.result import Result
from studies.report.style import ReportFigure, panels
from studies.tables import Column, Table, key_column

BEARABLE_PERCENT: Final = 1.0
"""Control-caused shortfall and over-delivery, in % of desired, below which it is survived."""

TROUBLES: Final[dict[Trouble, tuple[str, str, str]]] = {
    "delay": ("Every hop delayed", "delay of each hop", "s"),
    "loss": ("A share of all messages lost", "lost messages", "%"),
    "period": ("A slow central controller", "central period", "s"),
}
"""Title of each trouble, what measures it, and its unit."""

_LEGEND: Final = (
    "absent: inputs that had not come at their deadline",
    "old inputs: older messages used in their place",
    f"the first {WARM_UP_S:g} s of each run do not count, except for these two",
)

_DRAWN: Final = ("control-caused", "over-delivered", "mileage", "regd", "score")
_CAPTION: Final = (
    "Along each panel one thing is worse than in the scenario, in even steps from nothing to very "
    "bad; everything else is perfect."
)


def study_result(
    preparation: Preparation, settings: Sequence[str], outcomes: Sequence[Outcome]
) -> Result:
    """Return the tables, and how much of each trouble the plant survives."""
    title, remarks = preparation.title(), remarks_of(preparation)
    return Result(
        f"{title}: delay, loss and a slow central controller",
        [trouble_table(trouble, outcomes) for trouble in VALUES],
        {"title": title, "settings": settings, "remarks": remarks, "outcomes": outcomes},
        lines=[title, *remarks, *_LEGEND],
        conclusions=survived(outcomes),
        figures=lambda: [_study_figure(outcomes)],
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
        Column("absent", name="absent_inputs"),
        Column("old inputs", name="old_inputs"),
    )
    rows = [
        (
            f"{one.value:g}",
            one.scheme,
            *(one.figures[figure.name] for figure in figures),
            one.absent_inputs,
            one.old_inputs,
        )
        for one in outcomes
        if one.trouble == trouble
    ]
    return Table(title, columns, rows)


def _has_value(merit: str, outcomes: Sequence[Outcome]) -> bool:
    """Whether any run has this figure of merit: without regulation some have no value."""
    return any(one.figures[merit] is not None for one in outcomes)


def _study_figure(outcomes: Sequence[Outcome]) -> ReportFigure:
    """Draw a panel for each figure of merit and each trouble, in even steps of the trouble."""

    def points(merit: str, trouble: Trouble, scheme: str) -> tuple[list[str], list[float | None]]:
        found = column_of(outcomes, trouble, scheme)
        return [f"{one.value:g}" for one in found], [one.figures[merit] for one in found]

    rows = {
        merit: FIGURES_OF_MERIT[merit].heading for merit in _DRAWN if _has_value(merit, outcomes)
    }
    columns = {name: f"{measure} [{unit}]" for name, (_, measure, unit) in TROUBLES.items()}
    figure = panels(rows, columns, get_args(Scheme), points)
    figure.update_xaxes(type="category")
    return ReportFigure("study", "What each trouble costs", _CAPTION, figure)
