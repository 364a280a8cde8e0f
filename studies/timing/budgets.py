"""Budgets: what a run's timing may come to at most, line by line, and whether it does.

Hop latencies have their budgets in the table of signals. Those of the tiers follow the cycle's
length, since what a controller may take depends on how often it must be ready; the paper's upper
bounds hold besides (section II-B: direct below 1 s, supervisor within 10 s, central below 60 s). A
scenario may put absolute ones in their place.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from math import inf
from typing import Final

import msgspec

from agents.cycle import STAGES, kind_of
from agents.plan import RunPlan
from bus_schemas.signals import SIGNALS, listeners, ports
from bus_schemas.tree import CENTRAL, PLANT, RECORDER
from launch_scripts.scenarios.budget_table import BudgetTable
from studies.timing.run_timing import LOOP, WHOLE_LOOP, Times, tier_of
from studies.timing.tiers import TierAccount

_PAPER_MS: Final = {"direct": 1_000.0, "supervisor": 10_000.0, CENTRAL: 60_000.0}

_LOOP_SHARE: Final = 0.5
"""Of the cycle: the other half is the reserve for the cycle in which something goes wrong."""

_LATENESS_SHARE: Final = 0.02
_LEAST_LATENESS_MS: Final = 1.0
"""A tick may come late by 2 % of the cycle; a general-purpose kernel does not promise less."""

_CPU_PERCENT: Final = 80.0
"""Of one core, for each process: at more it has nothing left to catch up with."""


class Verdict(msgspec.Struct, frozen=True):
    """One budget, and whether the run kept it.

    Attributes
    ----------
    line
        What it is about: `hop impp p99`.
    measure, of
        The row of durations that it judges, empty where it judges a count.
    value, limit
        What was measured, None if nothing was, and what it may be at most.
    unit
        Of both: `ms`, `%`, `MB`, or empty for a count.
    passed
        Whether the budget was kept. Where nothing was measured it was not.
    """

    line: str
    measure: str
    of: str
    value: float | None
    limit: float
    unit: str
    passed: bool


class Budgets(msgspec.Struct, frozen=True):
    """All budgets of one run at one rate.

    Attributes
    ----------
    times_p99_ms
        By measure, then by row, or else by kind of process or signal.
    loop_p99_ms, loop_max_ms
        Of the whole loop.
    table
        The scenario's table, for the counts.
    """

    times_p99_ms: dict[str, dict[str, float]]
    loop_p99_ms: float
    loop_max_ms: float | None
    table: BudgetTable


def budgets_of(plan: RunPlan, table: BudgetTable) -> Budgets:
    """Return the budgets of a run: the scenario's, and defaults that follow the cycle."""
    cycle_ms = plan.cycle_wall_ns / 1e6
    lateness = {PLANT: max(_LATENESS_SHARE * cycle_ms, _LEAST_LATENESS_MS)}
    hop = {signal.name: signal.hop_p99_ms for signal in SIGNALS if signal.hop_p99_ms is not None}
    return Budgets(
        times_p99_ms={
            "decision": _decision_limits_ms(plan, table),
            "response": _response_limits_ms(plan, table),
            "lateness": lateness | table.lateness_p99_ms,
            "jitter": table.jitter_p99_ms,
            "age": table.age_p99_ms,
            "hop": hop | table.hop_p99_ms,
        },
        loop_p99_ms=table.loop_p99_ms or _LOOP_SHARE * cycle_ms,
        loop_max_ms=table.loop_max_ms,
        table=table,
    )


def _decision_limits_ms(plan: RunPlan, table: BudgetTable) -> dict[str, float]:
    """Return the limits of decision times: by tier and stage, and by kind, that of its first stage.

    A row of a tier is of all its processes, so the shortest of their slices holds.
    """
    found: dict[str, float] = {}
    for agent in plan.tree.agents():
        kind = kind_of(agent, plan.tree)
        for stage in STAGES.get(kind, ()):
            limit_ms = _decision_limit_ms(agent, stage, plan, table)
            row = f"{tier_of(agent, plan.tree)} {stage}"
            found[row] = min(limit_ms, found.get(row, limit_ms))
            found.setdefault(kind, limit_ms)
    return found


def _response_limits_ms(plan: RunPlan, table: BudgetTable) -> dict[str, float]:
    """Return the limits of the response times of external agents, by agent and stage."""
    return {
        f"{agent} {stage}": _decision_limit_ms(agent, stage, plan, table)
        for agent in plan.external
        for stage in STAGES.get(kind_of(agent, plan.tree), ())
    }


def _decision_limit_ms(agent: str, stage: str, plan: RunPlan, table: BudgetTable) -> float:
    kind = kind_of(agent, plan.tree)
    stated_ms = table.decision_p99_ms.get(kind)
    if stated_ms is not None:
        return stated_ms
    return min(plan.deadlines.slice_ns(agent, stage) / 1e6, _PAPER_MS.get(kind, inf))


def expected_rows(plan: RunPlan) -> set[tuple[str, str]]:
    """Measure, and row, kind or signal, of what a run must have measured if it was at work."""
    tree, external = plan.tree, set(plan.external)
    own = set(tree.agents()) - external - {RECORDER}
    expected = {(LOOP, WHOLE_LOOP)}
    expected |= {("decision", kind_of(agent, tree)) for agent in own}
    expected |= {("response", row) for row in _response_limits_ms(plan, BudgetTable())}
    for port in ports(tree):
        heard = own.intersection(listeners(port, tree))
        if port.signal.hop_p99_ms is not None and port.publisher in own and heard:
            expected.add(("hop", port.signal.name))
    return expected


def judge(
    budgets: Budgets,
    times: Sequence[Times],
    tiers: Sequence[TierAccount],
    lost_messages: int | None,
    expected: Collection[tuple[str, str]],
) -> tuple[Verdict, ...]:
    """Hold what was measured against the budgets.

    Parameters
    ----------
    budgets
        Of the run.
    times, tiers
        What was measured.
    lost_messages
        How many messages are not in the recording; None if it is not known.
    expected
        Measure, and row, kind or signal, of what must have been measured: of these no row is a
        failure, a row that is not there being no row that is good.
    """
    return (
        *_loop_verdicts(budgets, times),
        *_time_verdicts(budgets, times),
        *_absent_verdicts(budgets, times, expected),
        *_count_verdicts(budgets.table, tiers, lost_messages),
        *_share_verdicts(budgets.table, tiers),
    )


def _loop_verdicts(budgets: Budgets, times: Iterable[Times]) -> Iterator[Verdict]:
    row = next((row for row in times if (row.measure, row.of) == (LOOP, WHOLE_LOOP)), None)
    if row is None:
        return
    limits = (
        ("p99", row.times.p99_us, budgets.loop_p99_ms),
        ("max", row.times.max_us, budgets.loop_max_ms),
    )
    for statistic, value_us, limit_ms in limits:
        if limit_ms is not None:
            yield _verdict(row, statistic, value_us, limit_ms)


def _time_verdicts(budgets: Budgets, times: Iterable[Times]) -> Iterator[Verdict]:
    for row in times:
        limits_ms = budgets.times_p99_ms.get(row.measure, {})
        limit_ms = limits_ms.get(row.of, limits_ms.get(row.kind))
        if limit_ms is not None:
            yield _verdict(row, "p99", row.times.p99_us, limit_ms)


def _verdict(row: Times, statistic: str, value_us: float, limit_ms: float) -> Verdict:
    line = f"{row.measure} {row.of} {statistic}"
    value_ms = value_us / 1e3
    return Verdict(line, row.measure, row.of, value_ms, limit_ms, "ms", value_ms <= limit_ms)


def _absent_verdicts(
    budgets: Budgets, times: Sequence[Times], expected: Collection[tuple[str, str]]
) -> Iterator[Verdict]:
    there = {(row.measure, of) for row in times for of in (row.kind, row.of)}
    for measure, of in sorted(set(expected) - there):
        limits_ms = budgets.times_p99_ms.get(measure, {of: budgets.loop_p99_ms})
        if of in limits_ms:
            line = f"{measure} {of} p99"
            yield Verdict(line, measure, of, None, limits_ms[of], "ms", passed=False)


def _count_verdicts(
    table: BudgetTable, tiers: Sequence[TierAccount], lost_messages: int | None
) -> Iterator[Verdict]:
    known = [tier.dropped for tier in tiers if tier.dropped is not None]
    counts = (
        ("missed deadlines", sum(tier.missed_deadlines for tier in tiers), table.missed_deadlines),
        ("overruns", sum(tier.overruns for tier in tiers), table.overruns),
        ("skipped cycles", sum(tier.skipped_cycles for tier in tiers), table.skipped_cycles),
        ("messages not recorded", lost_messages, table.lost_messages),
        ("dropped messages", sum(known) if known else None, table.dropped_messages),
    )
    for line, count, limit in counts:
        if limit is not None and count is not None:
            yield Verdict(line, "", "", count, limit, "", count <= limit)


def _share_verdicts(table: BudgetTable, tiers: Sequence[TierAccount]) -> Iterator[Verdict]:
    for tier in tiers:
        limits = (
            ("CPU", tier.cpu_highest_percent, table.cpu_percent.get(tier.kind, _CPU_PERCENT), "%"),
            ("memory", tier.resident_mb, table.resident_mb.get(tier.kind), "MB"),
        )
        for what, value, limit, unit in limits:
            if value is not None and limit is not None:
                line = f"{what} of a {tier.tier}"
                yield Verdict(line, "", "", value, limit, unit, value <= limit)
