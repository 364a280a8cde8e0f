"""A campaign as an HTML page: its table, and the worst seeds as plots; or its curves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, get_args

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from launch_scripts.scenarios.preparation import Preparation
from studies.campaign.curves import (
    MEASURES,
    RATES_PER_H,
    REPAIRS_S,
    Point,
    Protection,
    means,
    repair_text,
)
from studies.campaign.study import Campaign, Outcome, rerun
from studies.campaign.tables import campaign_table
from studies.report import style
from studies.report.page import html_page

_DRAWN: Final = 3
_HEIGHT_PX: Final = 320
_PANEL_PX: Final = 260
_COSTS: Final[dict[str, Callable[[Outcome], float]]] = {
    "over-delivered": lambda outcome: outcome.over_kwh,
    "under-delivered": lambda outcome: outcome.under_kwh,
}


def campaign_page(preparation: Preparation, campaign: Campaign, outcomes: Sequence[Outcome]) -> str:
    """Return the page. Seeds that broke an invariant come first, then the most expensive ones."""
    table = campaign_table(preparation, outcomes)
    broken = [outcome for outcome in outcomes if outcome.violations]
    verdict = (not broken, f"{len(broken):,} of {len(outcomes):,} seeds broke an invariant")
    drawn = {outcome.seed: outcome for outcome in broken[:_DRAWN]}
    for measure in _COSTS.values():
        worst = sorted(outcomes, key=measure, reverse=True)[:_DRAWN]
        drawn |= {outcome.seed: outcome for outcome in worst}
    figures = [_seed_figure(campaign, outcome) for outcome in drawn.values()]
    paragraphs = ["Drawn are seeds that broke an invariant, and those that cost most energy."]
    return html_page(f"Campaign: {table.title}", paragraphs, [table, *figures], verdict=verdict)


def curve_figure(points: Sequence[Point]) -> style.ReportFigure:
    """Draw each measure against the failure rate, in a panel for each repair time."""
    figure = make_subplots(2, len(REPAIRS_S), shared_yaxes=True, shared_xaxes=True)
    for row, (measure, name) in enumerate(MEASURES.items(), start=1):
        for column, repair_s in enumerate(REPAIRS_S, start=1):
            for colour, protection in zip(style.SCHEMES, get_args(Protection), strict=False):
                line = go.Scatter(
                    x=RATES_PER_H,
                    y=means(points, measure, protection, repair_s),
                    name=protection,
                    legendgroup=protection,
                    showlegend=row == column == 1,
                    mode="lines+markers",
                    line={"color": colour, "width": 1.6},
                    marker={"color": colour, "size": 5},
                )
                figure.add_trace(line, row, column)
            title = f"/h, back: {repair_text(repair_s)}" if row == len(MEASURES) else None
            figure.update_xaxes(row=row, col=column, type="log", title_text=title)
            figure.update_yaxes(row=row, col=column, type="log", title_text=None)
        figure.update_yaxes(row=row, col=1, title_text=f"{name} [%]")
    caption = (
        "Every controller dies at random, as often in an hour as the axis says, and is back after "
        "the time below it. Nothing, 0, is not drawn. Without the ladder a node obeys the last "
        "message for "
        "ever; without revert an inverter obeys its last command for ever."
    )
    figure = style.dress(figure, 2 * _PANEL_PX)
    return style.ReportFigure("curves", "What failures cost", caption, figure)


def _seed_figure(campaign: Campaign, outcome: Outcome) -> style.ReportFigure:
    """Draw the power of a seed beside what was desired and the run without faults."""
    trace = rerun(campaign, outcome)
    cycle_s = campaign.plan.cycle_ns / 1e9
    time_s = np.arange(len(trace.produced)) * cycle_s
    lines = (
        ("desired", trace.desired_kw, style.BLACK, "dot"),
        ("without faults", campaign.healthy_kw[: len(time_s)], style.GREY, "solid"),
        ("with faults", trace.delivered_kw, style.BLUE, "solid"),
    )
    figure = go.Figure(
        [
            go.Scatter(x=time_s, y=kw, name=name, line={"color": colour, "dash": dash})
            for name, kw, colour, dash in lines
        ]
    )
    for rule in outcome.fault_rules:
        figure.add_vrect(
            rule.at[0], rule.at[-1], fillcolor=style.VERMILLION, opacity=0.12, line_width=1
        )
    figure.update_xaxes(title_text="time since the first cycle [s]")
    figure.update_yaxes(title_text="power [kW]")
    costs = ", ".join(f"{name} {cost(outcome):,.2f} kWh" for name, cost in _COSTS.items())
    broken = "".join(f"{one.invariant}: {one.text}. " for one in outcome.violations)
    caption = f"{broken}Faults: {' and '.join(outcome.rules)}; {costs}."
    figure = style.dress(figure, _HEIGHT_PX)
    return style.ReportFigure(f"seed-{outcome.seed}", f"Seed {outcome.seed}", caption, figure)
