"""The study of delay and loss as one HTML page, with its figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, get_args

from agents.plan import Scheme
from launch_scripts.scenarios.preparation import Preparation
from studies.delays.figures import StudyCurve, study_figure
from studies.delays.study import VALUES, Outcome
from studies.delays.table import (
    MERITS,
    TROUBLES,
    column_of,
    study_notes,
    study_title,
    survived,
    trouble_table,
)
from studies.report.page import html_page
from studies.timing.figure_tables import page_table

_DRAWN: Final = ("control-caused [%]", "mileage [kW/h]", "RegD fulfilled [%]", "PJM score")
_CAPTION: Final = (
    "Along each panel one thing is worse than in the scenario, in even steps from nothing to very "
    "bad; all else is perfect."
)


def study_page(preparation: Preparation, outcomes: Sequence[Outcome]) -> str:
    """Return the page."""
    title = f"{study_title(preparation)}: delay, loss and a slow central controller"
    figure = study_figure("study", "What each trouble costs", _CAPTION, study_curves(outcomes))
    notes = [*study_notes(preparation), *survived(outcomes)]
    tables = [page_table(trouble_table(trouble, outcomes)) for trouble in VALUES]
    return html_page(title, notes, tables, [figure])


def study_curves(outcomes: Sequence[Outcome]) -> list[StudyCurve]:
    """Return what the figure draws: each merit along each trouble, a curve for each scheme."""
    curves = []
    for merit in _DRAWN:
        for trouble, (_, unit) in TROUBLES.items():
            for scheme in get_args(Scheme):
                column = column_of(outcomes, trouble, scheme)
                merits = [MERITS[merit](one) for one in column]
                curves.append(
                    StudyCurve(merit, unit, scheme, [one.value for one in column], merits)
                )
    return curves
