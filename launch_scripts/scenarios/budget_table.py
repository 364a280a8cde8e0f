"""The table `[timing]` of a scenario: what a run in real time is judged by."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

from agents.cycle import KINDS, STAGES
from bus_schemas.signals import SIGNALS

Limit: TypeAlias = Annotated[float, Meta(gt=0.0, le=1e12)]
Amount: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e12)]
Count: TypeAlias = Annotated[int, Meta(ge=0)]
Tier: TypeAlias = Annotated[str, Meta(pattern="|".join(f"^{tier}$" for tier in STAGES))]
AnyKind: TypeAlias = Annotated[str, Meta(pattern="|".join(f"^{kind}$" for kind in KINDS))]
HopSignal: TypeAlias = Annotated[
    str, Meta(pattern="|".join(f"^{row.name}$" for row in SIGNALS if row.hop_p99_ms is not None))
]


class BudgetTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Upper limits. What the table leaves out keeps its default."""

    loop_p99_ms: Annotated[
        Limit | None,
        Meta(description="From the plant's tick to its last command. Default: half the cycle."),
    ] = None
    loop_max_ms: Annotated[Limit | None, Meta(description="The same, in the slowest cycle.")] = None
    decision_p99_ms: Annotated[
        dict[Tier, Limit],
        Meta(description="By tier. Default: each stage's slice, and the paper's upper bounds."),
    ] = {}
    lateness_p99_ms: Annotated[
        dict[Tier, Limit],
        Meta(description="By tier. Default: for the plant's tick 2 % of the cycle, at least 1 ms."),
    ] = {}
    jitter_p99_ms: Annotated[dict[Tier, Limit], Meta(description="By tier, for each stage.")] = {}
    age_p99_ms: Annotated[dict[Tier, Limit], Meta(description="By tier, for each stage.")] = {}
    hop_p99_ms: Annotated[
        dict[HopSignal, Limit], Meta(description="By signal. Default: 10 ms.")
    ] = {}
    missed_deadlines: Annotated[Count, Meta(description="In the whole run, of all tiers.")] = 0
    overruns: Annotated[Count, Meta(description="In the whole run, of all tiers.")] = 0
    skipped_cycles: Annotated[Count, Meta(description="In the whole run, of all tiers.")] = 0
    lost_messages: Annotated[Count, Meta(description="In the whole run, of all tiers.")] = 0
    dropped_messages: Annotated[
        Count | None, Meta(description="In the whole run. Default: any number.")
    ] = None
    cpu_percent: Annotated[
        dict[AnyKind, Amount], Meta(description="By kind; of one core, per process. Default: 80.")
    ] = {}
    resident_mb: Annotated[dict[AnyKind, Amount], Meta(description="By kind, per process.")] = {}


class TimingTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a run in real time is judged by."""

    budgets: BudgetTable = BudgetTable()
