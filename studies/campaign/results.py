"""The result of a campaign, with the worst seeds as figures; or its curves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from math import inf
from statistics import fmean
from typing import Final, get_args

import numpy as np
import plotly.graph_objects as go

from launch_scripts.scenarios.preparation import Preparation
from studies.campaign.curves import RATES_PER_H, REPAIRS_S, Point, Protection
from studies.campaign.study import Campaign, Outcome, tried
from studies.report import style
from studies.report.result import Result
from studies.tables import Cell, Column, Table, key_column

_COSTS: Final = (
    ("Over-delivered", "kWh", "over_kwh"),
    ("Under-delivered", "kWh", "under_kwh"),
    ("Most over-delivered", "kW", "over_kw"),
    ("Most under-delivered", "kW", "under_kw"),
)
"""What an `Outcome` says of the cost of its faults: title, unit and field."""

_MEASURES: Final = {"over_percent": "Over-delivered", "short_percent": "Shortfall"}
"""What a `Point` says of the cost of failures."""

_DRAWN: Final = 6
_HEIGHT_PX: Final = 320


def campaign_result(
    preparation: Preparation, campaign: Campaign, outcomes: Sequence[Outcome]
) -> Result:
    """Return what the faults of all seeds cost, and how many seeds broke which invariant."""
    rows: list[tuple[Cell, ...]] = []
    for name, unit, field in _COSTS:
        values = [getattr(outcome, field) for outcome in outcomes]
        rows.append((name, unit, fmean(values), *np.quantile(values, (0.5, 0.99, 1.0)).tolist()))
    broken = [outcome for outcome in outcomes if outcome.violations]
    counts = Counter(outcome.violations[0].invariant for outcome in broken)
    listed = ", ".join(f"{name} {count:,}" for name, count in sorted(counts.items()))
    plan = preparation.plan
    begins = preparation.local_start()
    title = f"{plan.plant}: {len(outcomes):,} seeds of {plan.cycles} cycles from {begins}"
    columns = (
        key_column("", "figure"),
        key_column("", "unit"),
        *(Column(name, "", 2) for name in ("mean", "median", "99 %", "most")),
    )
    notes = (
        "All relative to the same run without faults.",
        f"Broken invariants, with the number of seeds: {listed or 'none'}.",
    )
    by_cost = sorted(outcomes, key=lambda one: one.over_kwh + one.under_kwh, reverse=True)
    drawn = sorted(by_cost, key=lambda one: not one.violations)[:_DRAWN]
    return Result(
        f"Campaign: {title}",
        [Table(title, columns, rows, notes)],
        outcomes,
        verdict=(not broken, f"{len(broken):,} of {len(outcomes):,} seeds broke an invariant"),
        figures=lambda: [_seed_figure(campaign, outcome) for outcome in drawn],
    )


def _seed_figure(campaign: Campaign, outcome: Outcome) -> style.ReportFigure:
    """Draw the power of a seed beside what was desired and the run without faults."""
    trace, _ = tried(campaign, outcome.fault_rules)
    cycles = len(trace.produced)
    time_s = np.arange(cycles) * campaign.plan.cycle_ns / 1e9
    figure = go.Figure()
    for name, kw, colour, dash in (
        ("desired", trace.desired_kw, style.BLACK, "dot"),
        ("without faults", campaign.healthy_kw[:cycles], style.GREY, "solid"),
        ("with faults", trace.delivered_kw, style.BLUE, "solid"),
    ):
        figure.add_scatter(x=time_s, y=kw, name=name, line={"color": colour, "dash": dash})
    for rule in outcome.fault_rules:
        figure.add_vrect(
            rule.at[0], rule.at[-1], fillcolor=style.VERMILLION, opacity=0.12, line_width=1
        )
    figure.update_xaxes(title_text="time since the first cycle [s]")
    figure.update_yaxes(title_text="power [kW]")
    broken = "".join(f"{one.invariant}: {one.text}. " for one in outcome.violations)
    caption = (
        f"{broken}Faults: {' and '.join(outcome.rules)}; over-delivered {outcome.over_kwh:,.2f} "
        f"kWh, under-delivered {outcome.under_kwh:,.2f} kWh."
    )
    figure = style.dress(figure, _HEIGHT_PX)
    return style.ReportFigure(f"seed-{outcome.seed}", f"Seed {outcome.seed}", caption, figure)


def curves_result(preparation: Preparation, points: Sequence[Point]) -> Result:
    """Return a table of each measure: a row for each protection and repair time."""
    plan, seeds = preparation.plan, len({point.seed for point in points})
    title = f"{plan.plant}, {plan.cycles} cycles from {preparation.local_start()}"
    title += f", mean of {seeds} seeds"
    columns = (
        key_column("Protection"),
        key_column("Back after"),
        *(Column(f"{rate:g} /h") for rate in RATES_PER_H),
    )
    tables = [
        Table(
            f"{name}, in % of the desired energy: {title}",
            columns,
            [
                (protection, _repair_text(repair_s), *_means(points, measure, protection, repair_s))
                for protection in get_args(Protection)
                for repair_s in REPAIRS_S
            ],
            ("Columns: how often each controller fails in an hour.",),
        )
        for measure, name in _MEASURES.items()
    ]
    figures = partial(_curve_figures, points)
    return Result(f"What failures cost: {title}", tables, points, figures=figures)


def _curve_figures(points: Sequence[Point]) -> list[style.ReportFigure]:
    """Draw each measure against the failure rate, in a panel for each repair time."""
    figure = style.panels(
        {measure: f"{name} [%]" for measure, name in _MEASURES.items()},
        {repair_s: f"/h, back: {_repair_text(repair_s)}" for repair_s in REPAIRS_S},
        get_args(Protection),
        lambda measure, repair_s, protection: (
            RATES_PER_H,
            _means(points, measure, protection, repair_s),
        ),
    )
    figure.update_xaxes(type="log")
    figure.update_yaxes(type="log")
    caption = (
        "Every controller dies at random, as often in an hour as the axis shows, and is back after "
        "the time below it. Zeros are not drawn. Without the ladder a node obeys the last message "
        "for ever; without revert an inverter obeys its last command for ever."
    )
    return [style.ReportFigure("curves", "What failures cost", caption, figure)]


def _means(
    points: Sequence[Point], measure: str, protection: Protection, repair_s: float
) -> list[float]:
    """Return the mean over the seeds at each failure rate."""
    return [
        fmean(
            getattr(point, measure)
            for point in points
            if (point.protection, point.repair_s, point.rate_per_h) == (protection, repair_s, rate)
        )
        for rate in RATES_PER_H
    ]


def _repair_text(repair_s: float) -> str:
    return "never" if repair_s == inf else f"{repair_s:g} s"
