"""The result of a campaign as a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from statistics import fmean
from typing import Final

import numpy as np

from results.report.result import Result
from results.tables import Cell, Column, Table, counted, key_column
from scenarios.preparation import Preparation
from studies.campaign.study import SeedResult

_COSTS: Final = (
    ("Over-delivered", "kWh", "over_kwh"),
    ("Under-delivered", "kWh", "under_kwh"),
    ("Most over-delivered", "kW", "over_kw"),
    ("Most under-delivered", "kW", "under_kw"),
)
"""What a `SeedResult` says of the cost of its faults: title, unit and field."""


def campaign_result(preparation: Preparation, seeds: Sequence[SeedResult]) -> Result:
    """Return what the faults of all seeds cost, and how many seeds broke which invariant."""
    rows: list[tuple[Cell, ...]] = []
    for name, unit, field in _COSTS:
        values = [getattr(seed, field) for seed in seeds]
        rows.append((name, unit, fmean(values), *np.quantile(values, (0.5, 0.99, 1.0)).tolist()))
    broken = [seed for seed in seeds if seed.violations]
    counts = Counter(seed.violations[0].invariant for seed in broken)
    listed = ", ".join(f"{name} {count:,}" for name, count in sorted(counts.items()))
    plan, begins = preparation.plan, preparation.local_start()
    count = counted(len(seeds), "seed")
    title = f"{plan.plant}: {count} of {plan.timing.cycles} cycles from {begins}"
    columns = (
        key_column("", "figure"),
        key_column("", "unit"),
        *(Column(name, "", 2) for name in ("mean", "median", "99 %", "most")),
    )
    notes = (
        "All relative to the same run without faults.",
        f"Broken invariants, with the number of seeds: {listed or 'none'}.",
    )
    return Result(
        f"Campaign: {title}",
        [Table(title, columns, rows, notes)],
        seeds,
        verdict=(
            not broken,
            f"{len(broken):,} of {count} broke an invariant",
        ),
    )
