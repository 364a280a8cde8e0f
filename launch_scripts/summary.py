"""What a run came to: the table at its end, and the same as JSON."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Mapping

import msgspec
from rich.console import Console
from rich.table import Table

from agents.lifeline import PlantPower
from agents.plan import RunPlan
from launch_scripts.supervision import Memory
from recordings.metrics import (
    CommitmentMetrics,
    RampMetrics,
    RegulationMetrics,
    RunMetrics,
    run_metrics,
)
from recordings.series import plant_series


class MessageCount(msgspec.Struct, frozen=True):
    """Messages of one signal: published by the agents, found in the recording, and the rest."""

    signal: str
    published: int
    recorded: int

    @property
    def lost(self) -> int:
        """Published and not recorded; negative: recorded and not published."""
        return self.published - self.recorded


class MemoryUse(msgspec.Struct, frozen=True):
    """Memory of the processes of one kind, the median process and the largest [MB]."""

    kind: str
    processes: int
    resident_median_mb: float
    resident_largest_mb: float
    own_median_mb: float


class RunSummary(msgspec.Struct, frozen=True, kw_only=True):
    """The figures of a run.

    `recording_ended` says why its recording does not go up to its end; it is empty if it does.
    """

    run_id: str
    scenario: str
    driver: str
    folder: str
    sim_start: str
    cycles: int
    cycle_s: float
    wall_s: float
    startup_s: float
    arming_rounds: int
    metrics: RunMetrics | None
    messages: tuple[MessageCount, ...]
    dropped: dict[str, int]
    missing_inputs: int
    memory: tuple[MemoryUse, ...]
    hindsight_neighbours: bool
    remarks: tuple[str, ...]
    interrupted: bool
    recording_ended: str = ""

    @property
    def cycles_per_s(self) -> float:
        """Cycles per second of wall time, arming left out."""
        return self.cycles / self.wall_s if self.wall_s > 0.0 else 0.0

    @property
    def lost(self) -> int:
        """Messages that differ between what was published and what was recorded."""
        return sum(abs(count.lost) for count in self.messages)

    def as_json(self) -> bytes:
        """Return the summary as JSON, with the figures that follow from others."""
        document = msgspec.to_builtins(self)
        document["cycles_per_s"] = self.cycles_per_s
        if self.metrics is not None:
            energy = self.metrics.commitment
            document["metrics"]["commitment"]["satisfied_percent"] = energy.satisfied_percent
        document["messages_lost"] = self.lost
        return msgspec.json.format(msgspec.json.encode(document), indent=2)


def plant_metrics(plan: RunPlan, power: PlantPower) -> RunMetrics | None:
    """Work out the figures of merit of a run; None of one without a complete cycle."""
    return run_metrics(plant_series(plan, power)) if power.desired_kw else None


def count_messages(
    published: Mapping[str, int], recorded: Mapping[str, int]
) -> tuple[MessageCount, ...]:
    """Set what was published beside what was recorded, signal by signal."""
    signals = dict.fromkeys([*published, *recorded])
    return tuple(
        MessageCount(signal, published.get(signal, 0), recorded.get(signal, 0))
        for signal in signals
    )


def memory_use(samples: Mapping[str, list[Memory]]) -> tuple[MemoryUse, ...]:
    """Summarise the largest memory seen of each process, kind by kind."""
    return tuple(
        MemoryUse(
            kind,
            len(values),
            statistics.median(value.resident_mb for value in values),
            max(value.resident_mb for value in values),
            statistics.median(value.own_mb for value in values),
        )
        for kind, values in samples.items()
    )


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
    return [
        ("messages published", f"{published:,}", f"{help_calls:,} of them calls for help"),
        ("messages recorded", f"{recorded:,}", ""),
        ("messages lost", f"{summary.lost:,}", ""),
        ("messages dropped", f"{sum(summary.dropped.values()):,}", dropped),
        ("inputs missed at deadlines", f"{summary.missing_inputs:,}", ""),
    ]


def _memory_rows(summary: RunSummary) -> list[tuple[str, str, str]]:
    return [
        (
            f"memory of {use.processes} {use.kind}",
            f"{use.resident_median_mb:.1f} MB",
            f"resident in each, {use.own_median_mb:.1f} MB its own",
        )
        for use in summary.memory
    ]


def merge_counts(counts: list[dict[str, int]]) -> dict[str, int]:
    """Add up counts by name."""
    total: Counter[str] = Counter()
    for count in counts:
        total.update(count)
    return dict(total)
