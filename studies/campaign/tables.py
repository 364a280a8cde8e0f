"""The table of a campaign."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from statistics import fmean, quantiles

from launch_scripts.scenarios.preparation import Preparation
from studies.campaign.study import Outcome
from studies.tables import Cell, Column, Table, key_column


def campaign_table(preparation: Preparation, outcomes: Sequence[Outcome]) -> Table:
    """Return what the faults of all seeds cost, and how many seeds broke which invariant."""
    figures = (
        ("Over-delivered", "kWh", [one.over_kwh for one in outcomes]),
        ("Under-delivered", "kWh", [one.under_kwh for one in outcomes]),
        ("Most over-delivered", "kW", [one.over_kw for one in outcomes]),
        ("Most under-delivered", "kW", [one.under_kw for one in outcomes]),
    )
    rows: list[tuple[Cell, ...]] = [
        (name, unit, fmean(values), _quantile(values, 0.5), _quantile(values, 0.99), max(values))
        for name, unit, values in figures
    ]
    broken = Counter(one.violations[0].invariant for one in outcomes if one.violations)
    listed = ", ".join(f"{name} {count:,}" for name, count in sorted(broken.items()))
    plan = preparation.plan
    title = f"{plan.plant}: {len(outcomes):,} seeds of {plan.cycles} cycles from "
    return Table(
        title + preparation.local_start(),
        (
            key_column("", "figure"),
            key_column("", "unit"),
            *(Column(name, "", 2) for name in ("mean", "median", "99 %", "most")),
        ),
        tuple(rows),
        (
            "All beside the same run without faults.",
            f"Broken invariants, by seeds: {listed or 'none'}.",
        ),
    )


def _quantile(values: Sequence[float], share: float) -> float:
    if len(values) == 1:
        return values[0]
    return quantiles(values, n=100, method="inclusive")[round(share * 100) - 1]
