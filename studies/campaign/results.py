"""The result of a campaign, with the worst seeds as figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from statistics import fmean
from typing import Final

import numpy as np
import plotly.graph_objects as go

from agents.faults import Kill
from results.report import style
from results.report.result import Result
from results.tables import Cell, Column, Table, key_column
from scenarios.preparation import Preparation
from studies.campaign.study import Campaign, SeedResult, judged_run

_COSTS: Final = (
    ("Over-delivered", "kWh", "over_kwh"),
    ("Under-delivered", "kWh", "under_kwh"),
    ("Most over-delivered", "kW", "over_kw"),
    ("Most under-delivered", "kW", "under_kw"),
)
"""What a `SeedResult` says of the cost of its faults: title, unit and field."""

_DRAWN: Final = 6
_HEIGHT_PX: Final = 320


def campaign_result(
    preparation: Preparation, campaign: Campaign, seeds: Sequence[SeedResult]
) -> Result:
    """Return what the faults of all seeds cost, and how many seeds broke which invariant."""
    rows: list[tuple[Cell, ...]] = []
    for name, unit, field in _COSTS:
        values = [getattr(seed, field) for seed in seeds]
        rows.append((name, unit, fmean(values), *np.quantile(values, (0.5, 0.99, 1.0)).tolist()))
    broken = [seed for seed in seeds if seed.violations]
    counts = Counter(seed.violations[0].invariant for seed in broken)
    listed = ", ".join(f"{name} {count:,}" for name, count in sorted(counts.items()))
    plan = preparation.plan
    begins = preparation.local_start()
    title = f"{plan.plant}: {len(seeds):,} seeds of {plan.timing.cycles} cycles from {begins}"
    columns = (
        key_column("", "figure"),
        key_column("", "unit"),
        *(Column(name, "", 2) for name in ("mean", "median", "99 %", "most")),
    )
    notes = (
        "All relative to the same run without faults.",
        f"Broken invariants, with the number of seeds: {listed or 'none'}.",
    )
    by_cost = sorted(seeds, key=lambda one: one.over_kwh + one.under_kwh, reverse=True)
    drawn = sorted(by_cost, key=lambda one: not one.violations)[:_DRAWN]
    return Result(
        f"Campaign: {title}",
        [Table(title, columns, rows, notes)],
        seeds,
        verdict=(not broken, f"{len(broken):,} of {len(seeds):,} seeds broke an invariant"),
        figures=lambda: [_seed_figure(campaign, seed) for seed in drawn],
    )


def _seed_figure(campaign: Campaign, seed: SeedResult) -> style.ReportFigure:
    """Draw the power of a seed beside the dispatch and the run without faults."""
    trace, _ = judged_run(campaign, seed.faults)
    cycles = len(trace.produced)
    time_s = np.arange(cycles) * campaign.plan.timing.cycle_ns / 1e9
    figure = go.Figure()
    for name, kw, colour, dash in (
        ("dispatch", trace.dispatch_kw, style.BLACK, "dot"),
        ("without faults", campaign.healthy_kw[:cycles], style.GREY, "solid"),
        ("with faults", trace.delivered_kw, style.BLUE, "solid"),
    ):
        figure.add_scatter(x=time_s, y=kw, name=name, line={"color": colour, "dash": dash})
    for fault in seed.faults:
        begin_s, end_s = (fault.at, fault.at) if isinstance(fault, Kill) else fault.at or (0.0, 0.0)
        figure.add_vrect(begin_s, end_s, fillcolor=style.VERMILLION, opacity=0.12, line_width=1)
    figure.update_xaxes(title_text="time since the first cycle [s]")
    figure.update_yaxes(title_text="power [kW]")
    broken = "".join(f"{one.invariant}: {one.text}. " for one in seed.violations)
    caption = (
        f"{broken}Faults: {' and '.join(seed.rules)}; over-delivered {seed.over_kwh:,.2f} "
        f"kWh, under-delivered {seed.under_kwh:,.2f} kWh."
    )
    figure = style.dress(figure, _HEIGHT_PX)
    return style.ReportFigure(f"seed-{seed.seed}", f"Seed {seed.seed}", caption, figure)
