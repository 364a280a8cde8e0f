"""The table at the end of a run: its energy and what it was held to, its messages, its memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from rich.console import Console
from rich.table import Table

from launch_scripts.launcher.summary import RunSummary
from launch_scripts.launcher.wrong_messages import one_line_each
from studies.metrics import CommitmentMetrics, RampMetrics, RegulationMetrics, RunMetrics

_MOST_WRONG: Final = 12
"""Kinds of wrong messages that the table names one by one."""


def print_summary(summary: RunSummary, console: Console) -> None:
    """Print the table."""
    title = f"{summary.scenario} from {summary.sim_start}, {summary.driver}"
    table = Table(title=title, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    table.add_column(style="dim")
    for name, value, note in (*_pace_rows(summary), *_metrics_rows(summary.metrics)):
        table.add_row(name, value, note)
    table.add_section()
    for name, value, note in (*_message_rows(summary), *_memory_rows(summary)):
        table.add_row(name, value, note)
    if summary.external or summary.wrong:
        table.add_section()
    for name, value, note in (*_external_rows(summary), *_wrong_rows(summary)):
        table.add_row(name, value, note)
    console.print(table)
    if summary.hindsight_neighbours:
        console.print("Clusters and neighbours were chosen from the run's own data: hindsight.")


def _pace_rows(summary: RunSummary) -> list[tuple[str, str, str]]:
    simulated_s = summary.cycles * summary.cycle_s
    speed = simulated_s / summary.wall_s if summary.wall_s > 0.0 else 0.0
    return [
        ("cycles", f"{summary.cycles:,}", f"of {summary.cycle_s:g} s"),
        ("cycle rate", f"{summary.cycles_per_s:,.1f} /s", f"{speed:,.0f} x real time"),
        ("wall time", f"{summary.wall_s:,.1f} s", f"after {summary.startup_s:.1f} s to start up"),
    ]


def _energy_rows(energy: CommitmentMetrics) -> list[tuple[str, str, str]]:
    def percent(value_kwh: float) -> str:
        value = energy.percent(value_kwh)
        return "nothing was desired" if value is None else f"{value:.3f} % of desired"

    satisfied = energy.satisfied_percent
    return [
        ("desired energy", f"{energy.desired_kwh:,.1f} kWh", ""),
        ("possible energy", f"{energy.possible_kwh:,.1f} kWh", "all inverters at their maximum"),
        ("delivered energy", f"{energy.delivered_kwh:,.1f} kWh", ""),
        ("satisfied commitment", "-" if satisfied is None else f"{satisfied:.3f} %", ""),
        ("unsatisfied", f"{energy.unsatisfied_kwh:,.2f} kWh", percent(energy.unsatisfied_kwh)),
        ("  unavoidable", f"{energy.unavoidable_kwh:,.2f} kWh", percent(energy.unavoidable_kwh)),
        (
            "  control-caused",
            f"{energy.control_caused_kwh:,.2f} kWh",
            percent(energy.control_caused_kwh),
        ),
        ("over-delivered", f"{energy.over_delivered_kwh:,.2f} kWh", ""),
    ]


def _metrics_rows(metrics: RunMetrics | None) -> list[tuple[str, str, str]]:
    if metrics is None:
        return [("energy", "-", "no cycle was completed")]
    error, support = metrics.tracking, metrics.support
    return [
        *_energy_rows(metrics.commitment),
        (
            "tracking error",
            f"{error.rmse_kw:,.2f} kW",
            f"RMSE; mean absolute {error.mae_kw:,.2f} kW",
        ),
        (
            "support mileage",
            f"{support.per_hour_kw:,.0f} kW/h",
            f"{support.total_kw:,.0f} kW in all",
        ),
        *(_ramp_rows(metrics.ramps) if metrics.ramps else ()),
        *(_regulation_rows(metrics.regulation) if metrics.regulation else ()),
    ]


def _ramp_rows(ramps: RampMetrics) -> list[tuple[str, str, str]]:
    limit = ""
    if ramps.limit_kw_per_min is not None:
        limit = f", {ramps.above_limit_percent:.1f} % above {ramps.limit_kw_per_min:,.0f} kW"
    largest = max(ramps.largest_up_kw_per_min, ramps.largest_down_kw_per_min)
    return [("largest ramp", f"{largest:,.0f} kW/min", f"of {ramps.minutes:,} minutes{limit}")]


def _regulation_rows(regulation: RegulationMetrics) -> list[tuple[str, str, str]]:
    rows = [
        (
            "regulation requests",
            f"{entry.fulfilled_percent:.2f} %",
            f"of {entry.requests:,} fulfilled, to {entry.tolerance_percent:g} % of the rating",
        )
        for entry in regulation.requests
    ]
    if (score := regulation.performance) is not None:
        parts = f"accuracy {score.accuracy:.2f}, delay {score.delay:.2f}"
        note = f"{parts}, precision {score.precision:.2f}"
        rows.append(("PJM performance score", f"{score.score:.3f}", note))
    return rows


def _message_rows(summary: RunSummary) -> list[tuple[str, str, str]]:
    published = sum(count.published for count in summary.messages)
    recorded = sum(count.recorded for count in summary.messages)
    help_calls = sum(count.recorded for count in summary.messages if count.signal == "help")
    dropped = ", ".join(f"{count:,} {cause}" for cause, count in summary.dropped.items())
    in_place = f"{summary.old_inputs:,} older ones used instead" if summary.old_inputs else ""
    return [
        ("messages published", f"{published:,}", f"{help_calls:,} of them calls for help"),
        ("messages recorded", f"{recorded:,}", ""),
        ("messages lost", f"{summary.lost:,}", ""),
        ("messages dropped", f"{sum(summary.dropped.values()):,}", dropped),
        ("inputs missed at deadlines", f"{summary.missing_inputs:,}", in_place),
        *_timing_rows(summary),
        *_fault_rows(summary),
    ]


def _timing_rows(summary: RunSummary) -> list[tuple[str, str, str]]:
    """Rows of a run over processes: what it took, and in real time which cycles were left out."""
    if not summary.processes:
        return []
    rows = []
    cpu_s = [process.cpu_s for process in summary.processes if process.cpu_s is not None]
    if summary.cycles and cpu_s:
        per_cycle = f"{1e3 * sum(cpu_s) / summary.cycles:.2f} ms"
        rows.append(("processor time per cycle", per_cycle, "all processes"))
    if summary.skipped_cycles:
        skipped = {process.agent: process.skipped_cycles for process in summary.processes}
        rows.append(("cycles skipped", f"{summary.skipped_cycles:,}", _most(skipped)))
    return rows


def _most(count_of: Mapping[str, int]) -> str:
    agent, most = max(count_of.items(), key=lambda entry: entry[1])
    return f"most by {agent}: {most:,}" if most else ""


def _fault_rows(summary: RunSummary) -> list[tuple[str, str, str]]:
    counts = ", ".join(f"{count:,} {what}" for what, count in summary.faults.items())
    total = sum(summary.faults.values())
    return [("faults of the network", f"{total:,}", counts)] if summary.faults else []


def _memory_rows(summary: RunSummary) -> list[tuple[str, str, str]]:
    return [
        (
            f"memory of {use.processes} {use.kind}",
            f"{use.resident_median_mb:.1f} MB",
            f"resident in each, {use.own_median_mb:.1f} MB its own",
        )
        for use in summary.memory
    ]


def _external_rows(summary: RunSummary) -> list[tuple[str, str, str]]:
    rows = []
    for account in summary.external:
        answered = f"answered {account.answered:,} times of {account.expected:,}"
        recorded = f"{sum(account.recorded.values()):,}"
        rows.append((f"external {account.agent}", recorded, f"messages recorded; {answered}"))
        if account.lost:
            # Gaps in their numbers tell, and these do not tell why.
            rows.append(("", f"{account.lost:,}", "lost: never came or could not be decoded"))
    return rows


def _wrong_rows(summary: RunSummary) -> list[tuple[str, str, str]]:
    found = one_line_each(summary.wrong)
    rows = [
        (f"wrong: {wrong.key}", f"{wrong.count:,}", f"{wrong.cause}: {wrong.example}")
        for wrong in found[:_MOST_WRONG]
    ]
    rest = found[_MOST_WRONG:]
    if rest:
        count = sum(wrong.count for wrong in rest)
        rows.append(("wrong: other keys", f"{count:,}", f"{len(rest)} more kinds, see --json"))
    return rows
