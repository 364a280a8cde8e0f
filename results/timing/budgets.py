"""Budgets: upper limits on a run's timing, and whether the run kept them.

Hop latencies have their budgets in the table of signals. Those of the tiers follow the length of
the cycle; the paper's upper bounds also hold (section II-B: direct below 1 s, supervisor within
10 s, central below 60 s). A scenario may replace them with absolute ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Final, TypeAlias

import msgspec

from agents.cycle import STAGES, kind_of
from agents.plan import RunPlan
from bus_schemas.signals import SIGNALS
from bus_schemas.tree import CENTRAL, PLANT
from results.timing.clocks import ACROSS
from results.timing.run_timing import LOOP, WHOLE_LOOP, TierTiming, Times, tier_of
from scenarios.scenario import BudgetTable

_PAPER_MS: Final = {"direct": 1_000.0, "supervisor": 10_000.0, CENTRAL: 60_000.0}

_LOOP_SHARE: Final = 0.5
"""Of the cycle: the other half is the reserve for a cycle in which something goes wrong."""

_LATENESS_SHARE: Final = 0.02
_LEAST_LATENESS_MS: Final = 1.0
"""A tick may be late by 2 % of the cycle; a general-purpose kernel promises no less than 1 ms."""

_CPU_PERCENT: Final = 80.0
"""Of one core, for each process: above it, nothing is left to catch up with."""

Limits: TypeAlias = dict[str, dict[str, float]]
"""Limits of p99 [ms], by measure; then by row, or by the kind of process or signal of the row."""


class Verdict(msgspec.Struct, frozen=True):
    """One budget, such as `hop residual p99`, and whether the run kept it.

    `measure` and `of` are the row of durations that it judges, empty for a count. `value` is None
    if nothing was measured: then it was not kept.
    """

    line: str
    measure: str
    of: str
    value: float | None
    limit: float
    unit: str
    passed: bool


def p99_limits_ms(plan: RunPlan, table: BudgetTable) -> Limits:
    """Return the budgets of a run: the scenario's, and defaults that follow the cycle."""
    cycle_ms = plan.timing.cycle_wall_ns / 1e6
    lateness = {PLANT: max(_LATENESS_SHARE * cycle_ms, _LEAST_LATENESS_MS)}
    hop = {signal.name: signal.hop_p99_ms for signal in SIGNALS if signal.hop_p99_ms is not None}
    decision: dict[str, float] = {}
    response: dict[str, float] = {}
    for agent in plan.tree.agents():
        kind, tier = kind_of(agent, plan.tree), tier_of(agent, plan.tree)
        for stage in STAGES.get(kind, ()):
            slice_ms = plan.deadlines.slice_ns(agent, stage) / 1e6
            default_ms = min(slice_ms, _PAPER_MS.get(kind, inf))
            limit_ms = table.decision_p99_ms.get(kind, default_ms)
            row = f"{tier} {stage}"
            if agent in plan.access.external:
                response[f"{agent} {stage}"] = limit_ms
            else:  # Of a tier's processes the shortest limit counts.
                decision[row] = min(limit_ms, decision.get(row, limit_ms))
    return {
        LOOP: {WHOLE_LOOP: table.loop_p99_ms or _LOOP_SHARE * cycle_ms},
        "decision": decision,
        "response": response,
        "lateness": lateness | table.lateness_p99_ms,
        "jitter": table.jitter_p99_ms,
        "age": table.age_p99_ms,
        # Between hosts only what the scenario states: the network is the user's own.
        "hop": hop
        | table.hop_p99_ms
        | {f"{signal}{ACROSS}": limit_ms for signal, limit_ms in table.hop_p99_ms.items()},
    }


def judge(
    plan: RunPlan,
    table: BudgetTable,
    times: Sequence[Times],
    tiers: Sequence[TierTiming],
    lost_messages: int | None,
) -> tuple[Verdict, ...]:
    """Compare what was measured with the budgets; `lost_messages` is None if it is not known."""
    verdicts: list[Verdict] = []

    def compare(line: str, value: float | None, limit: float | None, unit: str, *row: str) -> None:
        if value is not None and limit is not None:
            measure, of = row or ("", "")
            verdicts.append(Verdict(line, measure, of, value, limit, unit, value <= limit))

    limits_ms = p99_limits_ms(plan, table)
    unmeasured = {(one, of) for one in (LOOP, "decision", "response") for of in limits_ms[one]}
    unmeasured |= {("hop", signal) for signal in table.hop_p99_ms}
    for row in times:
        own_ms, judged = limits_ms[row.measure], (row.measure, row.of)
        line, limit_ms = f"{row.measure} {row.of}", own_ms.get(row.of, own_ms.get(row.kind))
        compare(f"{line} p99", row.times.p99_us / 1e3, limit_ms, "ms", *judged)
        if row.of == WHOLE_LOOP:
            compare(f"{line} max", row.times.max_us / 1e3, table.loop_max_ms, "ms", *judged)
        unmeasured -= {judged, (row.measure, row.kind.removesuffix(ACROSS))}
    for measure, of in sorted(unmeasured):
        line, limit_ms = f"{measure} {of} p99", limits_ms[measure][of]
        verdicts.append(Verdict(line, measure, of, None, limit_ms, "ms", passed=False))
    known = [tier.dropped for tier in tiers if tier.dropped is not None]
    dropped = sum(known) if known else None
    for line, count, limit in (
        ("missed deadlines", sum(tier.missed_deadlines for tier in tiers), table.missed_deadlines),
        ("overruns", sum(tier.overruns for tier in tiers), table.overruns),
        ("skipped cycles", sum(tier.skipped_cycles for tier in tiers), table.skipped_cycles),
        ("messages not recorded", lost_messages, table.lost_messages),
        ("dropped messages", dropped, table.dropped_messages),
    ):
        compare(line, count, limit, "")
    for tier in tiers:
        percent = table.cpu_percent.get(tier.kind, _CPU_PERCENT)
        compare(f"CPU of a {tier.tier}", tier.cpu_highest_percent, percent, "%")
        size_mb = table.resident_mb.get(tier.kind)
        compare(f"memory of a {tier.tier}", tier.resident_mb, size_mb, "MB")
    return tuple(verdicts)
