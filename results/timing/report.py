"""The report on a timed run: what was measured, the budgets, and whether they were kept.

Budgets are upper limits. Hop latencies have theirs in the table of signals. Those of the tiers
follow the length of the cycle; the paper's upper bounds also hold (section II-B: direct below 1 s,
supervisor within 10 s, central below 60 s). A scenario may replace them with absolute ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import pandas as pd

from agents.cycle import KINDS, STAGES, kind_of
from agents.plan import RunPlan
from agents.process.machine_watch import MachineStop
from bus_schemas.errors import InputError
from bus_schemas.signals import SIGNALS
from bus_schemas.tree import CENTRAL, PLANT
from recordings.read.reader import RunReader
from results.run_document import RunDocument, outcome_of
from results.timing.clocks import HostClock, clocks_of
from results.timing.devices import MOST_MISSED_PERCENT, DeviceTiming, devices_of
from results.timing.late_cycles import LateCycle, late_cycles
from results.timing.measures import COUNTS, LOOP, Floats, counts, durations, prepared, statistics
from results.timing.stages import stage_table, stops_of, tier_of
from scenarios.scenario import BudgetTable, TimingTable
from sunspec.process import DeviceAccount

_PAPER_MS: Final = {"direct": 1_000.0, "supervisor": 10_000.0, CENTRAL: 60_000.0}

_LOOP_SHARE: Final = 0.5
"""Of the cycle: the other half is the reserve for a cycle in which something goes wrong."""

_LATENESS_SHARE: Final = 0.02
_LEAST_LATENESS_MS: Final = 1.0
"""A tick may be late by 2 % of the cycle; a general-purpose kernel promises no less than 1 ms."""

_CPU_PERCENT: Final = 80.0
"""Of one core, for each process: above it, nothing is left to catch up with."""

FEW: Final = 100
"""The p99 of fewer durations is the longest one: a single one must not decide."""

_NO_SUMMARY: Final = (
    "no summary.json of this run beside the recording: processor time, memory, dropped and lost "
    "messages are not known"
)


class Budget(NamedTuple):
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


class TimedRun(msgspec.Struct, frozen=True, kw_only=True):
    """What was run. `lost_messages` is None if that is not known.

    In `late_stopped` of the late cycles the machine stood still. `ended` is false if the recording
    does not show that the plant ended the run, and `interrupted` is true if it did so before the
    last planned cycle.
    """

    scenario: str
    run_id: str
    folder: str
    rate_hz: float
    planned_cycles: int
    cycles: int
    late_cycles: int
    late_stopped: int
    wall_s: float
    ended: bool
    interrupted: bool
    lost_messages: int | None = None

    @property
    def whole(self) -> bool:
        return self.ended and not self.interrupted


class Host(msgspec.Struct, frozen=True, kw_only=True):
    """The machine, the software, and what was asked of the machine.

    stops: How often it stood still, for `longest_stop_ms` at most; None: nobody watched.
    """

    kernel: str
    cpus: str
    python: str
    heliarch: str
    zenoh: str
    priority: int
    bound_to: dict[str, tuple[int, ...]]
    load_before: float | None = None
    load_after: float | None = None
    stops: int | None = None
    longest_stop_ms: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TimingReport:
    """A timed run; docs/timing.md describes the tables. NaN: it is not known.

    host: The machine and the software: the figures mean nothing without them.
    stages: The tidy table. times: Rows of durations: by, measure, of, count, min_ms to max_ms.
    tiers: Counts, processor time and memory.
    """

    run: TimedRun
    host: Host
    clocks: tuple[HostClock, ...]
    stages: pd.DataFrame
    times: pd.DataFrame
    tiers: pd.DataFrame
    budgets: tuple[Budget, ...]
    late: tuple[LateCycle, ...]
    remarks: tuple[str, ...]
    external: tuple[DeviceTiming, ...]
    devices: tuple[DeviceAccount, ...]

    @property
    def passed(self) -> bool:
        """Whether every budget was kept up to the planned end of the run."""
        return self.run.whole and all(budget.passed for budget in self.budgets)

    @property
    def loop_ms(self) -> pd.Series:
        """How long the loop took, by cycle."""
        rows = self.stages[(self.stages.agent == PLANT) & (self.stages.stage == "apply")]
        return rows.ready.where(~rows.device, rows.arrived).set_axis(rows.cycle).dropna()

    def document(self) -> dict[str, object]:
        """Return the content of the JSON."""
        return {
            "passed": self.passed,
            "run": self.run,
            "host": self.host,
            "clocks": self.clocks,
            "times": self.times.to_dict("records"),
            "tiers": self.tiers.to_dict("records"),
            "budgets": [budget._asdict() for budget in self.budgets],
            "late_cycles": [one._asdict() for one in self.late],
            "remarks": self.remarks,
            "external": self.external,
            "devices": self.devices,
        }


def report_on(
    run: Path,
    summary: RunDocument | None = None,
    load: tuple[float, float] | None = None,
    stops: Sequence[MachineStop] | None = None,
) -> TimingReport:
    """Work out the timing of a run from its recording.

    Without a summary the one in the run's folder is used, if there is one. `load` is the machine's
    load average before and after the run, `stops` are the times in which it stood still; None: they
    are read from the run's folder.
    """
    with RunReader(run) as reader:
        plan, budgets = reader.plan, _budgets_in(reader)
        folder, metadata, outcome = reader.path.parent, reader.metadata["run"], outcome_of(reader)
        stops = stops_of(folder) if stops is None else stops
        stages = stage_table(reader, stops)
    table = prepared(stages, plan)
    late = late_cycles(table, plan)
    outcome = outcome._replace(document=summary or outcome.document)
    summary = outcome.document
    cycles = int(stages.cycle.max()) + 1
    wall_s = cycles * plan.timing.cycle_wall_ns / 1e9
    lost, remarks = None, [_NO_SUMMARY]
    if summary is not None:
        wall_s, lost = summary.wall_s, summary.lost
        remarks = [*summary.run.remarks, *filter(None, [summary.launcher.recording_ended])]
    tiers = _tiers(counts(table), summary, wall_s, plan)
    external = devices_of(table, plan)
    run_facts = TimedRun(
        scenario=plan.plant,
        run_id=plan.run_id,
        folder=str(folder),
        rate_hz=1e9 / plan.timing.cycle_wall_ns,
        planned_cycles=plan.timing.cycles,
        cycles=cycles,
        late_cycles=len(late),
        late_stopped=sum(one.stopped_ms > 0.0 for one in late),
        wall_s=wall_s,
        ended=outcome.stop_cycle is not None,
        interrupted=outcome.kind == "interrupted",
        lost_messages=lost,
    )
    return TimingReport(
        run=run_facts,
        host=_host(metadata, plan, load, stops),
        clocks=clocks_of(table, plan),
        stages=stages,
        times=statistics(table),
        tiers=tiers,
        budgets=tuple(_judged(plan, budgets, table, run_facts, tiers, external)),
        late=tuple(late),
        remarks=(*remarks, *(text for one in external for text in one.findings)),
        external=external,
        devices=summary.devices if summary else (),
    )


def p99_limits_ms(plan: RunPlan, table: BudgetTable) -> dict[tuple[str, str], float]:
    """Return the limits of the p99 [ms] by measure and row of durations.

    They are the scenario's, and defaults that follow the cycle.
    """
    cycle_ms = plan.timing.cycle_wall_ns / 1e6
    limits = {("loop", LOOP): table.loop_p99_ms or _LOOP_SHARE * cycle_ms}
    lateness = {PLANT: max(_LATENESS_SHARE * cycle_ms, _LEAST_LATENESS_MS), **table.lateness_p99_ms}
    stated: dict[str, Mapping[Any, float]] = {"lateness": lateness, "age": table.age_p99_ms}
    for agent in plan.tree.agents():
        kind = kind_of(agent, plan.tree)
        for stage in STAGES.get(kind, ()):
            row = f"{tier_of(agent, plan.tree)} {stage}"
            slice_ms = plan.deadlines.slice_ns(agent, stage) / 1e6
            limit_ms = table.decision_p99_ms.get(kind, min(slice_ms, _PAPER_MS.get(kind, inf)))
            if agent in plan.access.external:
                limits["response", f"{agent} {stage}"] = limit_ms
            else:  # Of a tier's processes the shortest limit counts.
                limits["decision", row] = min(limit_ms, limits.get(("decision", row), limit_ms))
            limits |= {(name, row): by[kind] for name, by in stated.items() if kind in by}
    for signal in SIGNALS:
        limit = table.hop_p99_ms.get(signal.name, signal.hop_p99_ms)
        if limit is not None:
            limits["hop", signal.name] = limit
    return limits


def _judged(
    plan: RunPlan,
    table: BudgetTable,
    rows: pd.DataFrame,
    run: TimedRun,
    tiers: pd.DataFrame,
    external: Sequence[DeviceTiming],
) -> Iterator[Budget]:
    """Compare what was measured with the budgets.

    A p99 is kept if at most 1 % of the durations, or a single one, are above the limit. What must
    be measured and was not is not kept.
    """
    by_row: dict[tuple[str, str], Floats] = {
        (measure, of): ms for measure, of, ms in durations(rows, "tier")
    }
    for (measure, of), limit_ms in p99_limits_ms(plan, table).items():
        must = measure in {"loop", "decision", "response"} or of in table.hop_p99_ms
        row, ms = (f"{measure} {of} p99", measure, of), by_row.get((measure, of))
        if ms is not None:
            passed = bool((ms > limit_ms).sum() <= max(len(ms) // FEW, len(ms) > 1))
            p99_ms = float(ms[-(len(ms) // FEW) - 1])
            yield Budget(*row, p99_ms, limit_ms, "ms", passed)
        elif must:
            yield Budget(*row, None, limit_ms, "ms", passed=False)
    loop_ms = by_row.get(("loop", LOOP))
    lines: list[tuple[str, float | None, float | None, str]] = [
        (
            "loop all commands max",
            None if loop_ms is None else loop_ms[-1],
            table.loop_max_ms,
            "ms",
        ),
        ("late cycles", 100.0 * run.late_cycles / run.cycles, table.late_cycles_percent, "%"),
        ("missed deadlines", tiers.missed_deadlines.sum(), table.missed_deadlines, ""),
        ("overruns", tiers.overruns.sum(), table.overruns, ""),
        ("skipped cycles", tiers.skipped_cycles.sum(), table.skipped_cycles, ""),
        ("dropped messages", tiers.dropped.sum(min_count=1), table.dropped_messages, ""),
    ]
    for tier in tiers.to_dict("records"):
        name, percent = tier["tier"], table.cpu_percent.get(tier["kind"], _CPU_PERCENT)
        lines.append((f"CPU of a {name}", tier["cpu_highest_percent"], percent, "%"))
        size_mb = table.resident_mb.get(tier["kind"])
        lines.append((f"memory of a {name}", tier["resident_mb"], size_mb, "MB"))
    for one in external:
        lines.append((f"late or silent {one.agent}", one.missed_percent, MOST_MISSED_PERCENT, "%"))
        lines.append((f"stamps of {one.agent}", one.stamps_off_ms, one.hop_p99_ms, "ms"))
    for line, value, limit, unit in lines:
        if limit is not None and value is not None and pd.notna(value):
            yield Budget(line, "", "", float(value), limit, unit, passed=bool(value <= limit))
    # A run whose losses are unknown is not clean.
    lost, most = run.lost_messages, table.lost_messages
    is_kept = lost is not None and lost <= most
    yield Budget("messages not recorded", "", "", lost, most, "", passed=is_kept)


def _tiers(
    processes: pd.DataFrame, summary: RunDocument | None, wall_s: float, plan: RunPlan
) -> pd.DataFrame:
    """Add up the processes of each tier; memory is the largest one's.

    The launcher knows dropped messages, processor time and memory, and it alone the recorder.
    """
    accounts = [
        (one.agent, sum(one.dropped.values()), one.cpu_s, one.resident_mb)
        for one in (summary.processes if summary else ())
    ]
    columns = ["agent", "dropped", "cpu_s", "resident_mb"]
    table = processes.merge(pd.DataFrame(accounts, columns=columns), how="outer", on="agent")
    table[COUNTS] = table[COUNTS].fillna(0).astype(int)
    table["cpu_percent"] = 100.0 * table.cpu_s.astype(float) / (wall_s or nan)
    table["tier"] = [tier_of(agent, plan.tree) for agent in table.agent]
    table["kind"] = [kind_of(agent, plan.tree) for agent in table.agent]
    table["order"] = table.kind.map(KINDS.index)
    rows = table.groupby(["order", "tier", "kind"])
    tiers = rows[[*COUNTS, "dropped"]].sum(min_count=1)
    tiers = tiers.assign(
        processes=rows.size(),
        cpu_percent=rows.cpu_percent.sum(min_count=1),
        cpu_highest_percent=rows.cpu_percent.max(),
        resident_mb=rows.resident_mb.max(),
    )
    return tiers.reset_index().drop(columns="order")


def _host(
    metadata: Mapping[str, str],
    plan: RunPlan,
    load: tuple[float, float] | None,
    stops: Sequence[MachineStop] | None,
) -> Host:
    names = ("kernel", "cpu_count", "python", "version heliarch", "version eclipse-zenoh")
    machine = plan.supervision.machine
    bound = [*machine.cpus_of.items(), ("others" if machine.cpus_of else "all", machine.cpus)]
    kernel, cpus, python, heliarch, zenoh = (metadata.get(name, "unknown") for name in names)
    return Host(
        kernel=kernel,
        cpus=cpus,
        python=python,
        heliarch=heliarch,
        zenoh=zenoh,
        priority=machine.priority or 0,
        bound_to={who: tuple(cpus) for who, cpus in bound if cpus},
        load_before=load[0] if load else None,
        load_after=load[1] if load else None,
        stops=None if stops is None else len(stops),
        longest_stop_ms=max((one.length_ms for one in stops or ()), default=0.0),
    )


def _budgets_in(reader: RunReader) -> BudgetTable:
    try:
        return msgspec.convert(reader.scenario_table().get("timing", {}), TimingTable).budgets
    except msgspec.ValidationError as error:
        raise InputError(f"{reader.path}: scenario.toml in it: {error}") from None
