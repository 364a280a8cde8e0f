"""Budgets: upper limits on a run's timing, and whether the run kept them.

Hop latencies have their budgets in the table of signals. Those of the tiers follow the length of
the cycle; the paper's upper bounds also hold (section II-B: direct below 1 s, supervisor within
10 s, central below 60 s). A scenario may replace them with absolute ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf
from typing import Final, TypeAlias

import msgspec

from agents.cycle import STAGES, kind_of
from agents.plan import RunPlan
from bus_schemas.signals import SIGNALS, listeners, ports
from bus_schemas.tree import CENTRAL, PLANT, RECORDER
from launch_scripts.scenarios.budget_table import BudgetTable
from studies.timing.clocks import ACROSS
from studies.timing.durations import Times
from studies.timing.measures import LOOP, WHOLE_LOOP
from studies.timing.processes import TierTiming, tier_of, total

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
    cycle_ms = plan.cycle_wall_ns / 1e6
    lateness = {PLANT: max(_LATENESS_SHARE * cycle_ms, _LEAST_LATENESS_MS)}
    hop = {signal.name: signal.hop_p99_ms for signal in SIGNALS if signal.hop_p99_ms is not None}
    return {
        LOOP: {WHOLE_LOOP: table.loop_p99_ms or _LOOP_SHARE * cycle_ms},
        "decision": _decision_limits_ms(plan, table),
        "response": {
            f"{agent} {stage}": _decision_limit_ms(agent, stage, plan, table)
            for agent in plan.external
            for stage in STAGES.get(kind_of(agent, plan.tree), ())
        },
        "lateness": lateness | table.lateness_p99_ms,
        "jitter": table.jitter_p99_ms,
        "age": table.age_p99_ms,
        # Between hosts only what the scenario states: the network is the user's own.
        "hop": hop
        | table.hop_p99_ms
        | {f"{signal}{ACROSS}": limit_ms for signal, limit_ms in table.hop_p99_ms.items()},
    }


def _decision_limits_ms(plan: RunPlan, table: BudgetTable) -> dict[str, float]:
    """Return limits by tier and stage, the shortest of the tier's processes, and by kind."""
    found: dict[str, float] = {}
    for agent in plan.tree.agents():
        kind = kind_of(agent, plan.tree)
        for stage in STAGES.get(kind, ()):
            limit_ms = _decision_limit_ms(agent, stage, plan, table)
            row = f"{tier_of(agent, plan.tree)} {stage}"
            found[row] = min(limit_ms, found.get(row, limit_ms))
            found.setdefault(kind, limit_ms)
    return found


def _decision_limit_ms(agent: str, stage: str, plan: RunPlan, table: BudgetTable) -> float:
    kind = kind_of(agent, plan.tree)
    stated_ms = table.decision_p99_ms.get(kind)
    if stated_ms is not None:
        return stated_ms
    return min(plan.deadlines.slice_ns(agent, stage) / 1e6, _PAPER_MS.get(kind, inf))


def judge(
    plan: RunPlan,
    table: BudgetTable,
    times: Sequence[Times],
    tiers: Sequence[TierTiming],
    lost_messages: int | None,
) -> tuple[Verdict, ...]:
    """Compare what was measured with the budgets; `lost_messages` is None if it is not known."""
    limits_ms = p99_limits_ms(plan, table)
    return (
        *_time_verdicts(limits_ms, table.loop_max_ms, times),
        *_absent_verdicts(limits_ms, times, _expected(plan, table, limits_ms)),
        *_count_verdicts(table, tiers, lost_messages),
        *_share_verdicts(table, tiers),
    )


def _time_verdicts(
    limits_ms: Limits, loop_max_ms: float | None, times: Sequence[Times]
) -> Iterator[Verdict]:
    for row in times:
        own_ms = limits_ms[row.measure]
        judged = [("p99", row.times.p99_us / 1e3, own_ms.get(row.of, own_ms.get(row.kind)))]
        if row.of == WHOLE_LOOP:
            judged.append(("max", row.times.max_us / 1e3, loop_max_ms))
        for name, value_ms, limit_ms in judged:
            if limit_ms is not None:
                line, kept = f"{row.measure} {row.of} {name}", value_ms <= limit_ms
                yield Verdict(line, row.measure, row.of, value_ms, limit_ms, "ms", kept)


def _expected(plan: RunPlan, table: BudgetTable, limits_ms: Limits) -> set[tuple[str, str]]:
    """Return measure and row, kind or signal of what a working run must have measured."""
    tree, external = plan.tree, set(plan.external)
    own = set(tree.agents()) - external - {RECORDER}
    expected = {(LOOP, WHOLE_LOOP)}
    expected |= {("decision", kind_of(agent, tree)) for agent in own}
    expected |= {("response", row) for row in limits_ms["response"]}
    expected |= {("hop", signal) for signal in table.hop_p99_ms}
    for port in ports(tree):
        heard = own.intersection(listeners(port, tree))
        if port.signal.hop_p99_ms is not None and port.publisher in own and heard:
            expected.add(("hop", port.signal.name))
    return expected


def _absent_verdicts(
    limits_ms: Limits, times: Sequence[Times], expected: set[tuple[str, str]]
) -> Iterator[Verdict]:
    there = {(row.measure, of.removesuffix(ACROSS)) for row in times for of in (row.kind, row.of)}
    for measure, of in sorted(expected - there):
        if of in limits_ms[measure]:
            limit_ms = limits_ms[measure][of]
            yield Verdict(f"{measure} {of} p99", measure, of, None, limit_ms, "ms", passed=False)


def _count_verdicts(
    table: BudgetTable, tiers: Sequence[TierTiming], lost_messages: int | None
) -> Iterator[Verdict]:
    counts = (
        ("missed deadlines", sum(tier.missed_deadlines for tier in tiers), table.missed_deadlines),
        ("overruns", sum(tier.overruns for tier in tiers), table.overruns),
        ("skipped cycles", sum(tier.skipped_cycles for tier in tiers), table.skipped_cycles),
        ("messages not recorded", lost_messages, table.lost_messages),
        ("dropped messages", total(tier.dropped for tier in tiers), table.dropped_messages),
    )
    for line, count, limit in counts:
        if limit is not None and count is not None:
            yield Verdict(line, "", "", count, limit, "", count <= limit)


def _share_verdicts(table: BudgetTable, tiers: Sequence[TierTiming]) -> Iterator[Verdict]:
    for tier in tiers:
        limits = (
            ("CPU", tier.cpu_highest_percent, table.cpu_percent.get(tier.kind, _CPU_PERCENT), "%"),
            ("memory", tier.resident_mb, table.resident_mb.get(tier.kind), "MB"),
        )
        for what, value, limit, unit in limits:
            if value is not None and limit is not None:
                line = f"{what} of a {tier.tier}"
                yield Verdict(line, "", "", value, limit, unit, value <= limit)
