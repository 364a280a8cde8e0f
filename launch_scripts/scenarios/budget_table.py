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
    """Upper limits. What the table leaves out keeps its default.

    loop_p99_ms: From the plant's tick to its last command. Default: half the cycle.
    loop_max_ms: The same, in the slowest cycle.
    decision_p99_ms: By tier. Default: each stage's slice, and the paper's upper bounds.
    lateness_p99_ms: By tier. Default: for the plant's tick 2 % of the cycle, at least 1 ms.
    jitter_p99_ms: By tier, for each stage.
    age_p99_ms: By tier, for each stage.
    hop_p99_ms: By signal. Default: 10 ms.
    missed_deadlines: In the whole run, of all tiers.
    overruns: In the whole run, of all tiers.
    skipped_cycles: In the whole run, of all tiers.
    lost_messages: In the whole run, of all tiers.
    dropped_messages: In the whole run. Default: any number.
    cpu_percent: By kind; of one core, per process. Default: 80.
    resident_mb: By kind, per process.
    """

    loop_p99_ms: Limit | None = None
    loop_max_ms: Limit | None = None
    decision_p99_ms: dict[Tier, Limit] = {}
    lateness_p99_ms: dict[Tier, Limit] = {}
    jitter_p99_ms: dict[Tier, Limit] = {}
    age_p99_ms: dict[Tier, Limit] = {}
    hop_p99_ms: dict[HopSignal, Limit] = {}
    missed_deadlines: Count = 0
    overruns: Count = 0
    skipped_cycles: Count = 0
    lost_messages: Count = 0
    dropped_messages: Count | None = None
    cpu_percent: dict[AnyKind, Amount] = {}
    resident_mb: dict[AnyKind, Amount] = {}


class TimingTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a run in real time is judged by."""

    budgets: BudgetTable = BudgetTable()
