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
from results.timing.measures import LOOP, loop_ms, statistics
from results.timing.stages import OVERRUN, SILENT, WITHOUT, stage_table, stops_of, tier_of
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

_COUNTS: Final = {"missed_deadlines": WITHOUT, "overruns": OVERRUN, "skipped_cycles": SILENT}


class Budget(NamedTuple):
    """One budget, such as `hop residual p99`.

    `measure` and `of` are the row of durations that it judges, empty for a count. `value` is None
    if nothing was measured: then it was not kept.
    """

    line: str
    measure: str
    of: str
    value: float | None
    limit: float
    unit: str

    @property
    def passed(self) -> bool:
        return self.value is not None and self.value <= self.limit


class TimedRun(msgspec.Struct, frozen=True, kw_only=True):
    """What was run. `lost_messages` is None if that is not known.

    `ended` is false if the recording does not show that the plant ended the run, and `interrupted`
    is true if it did so before the last planned cycle.
    """

    scenario: str
    run_id: str
    rate_hz: float
    planned_cycles: int
    cycles: int
    late_cycles: int
    wall_s: float
    ended: bool
    interrupted: bool
    lost_messages: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TimingReport:
    """A timed run; docs/timing.md describes the tables. NaN: it is not known.

    host: The machine, the software, and what was asked of the machine: the figures mean nothing
        without them. `stops` says how often it stood still; None: nobody watched.
    stages: The tidy table. times: Rows of durations: by, measure, of, count, min_ms to max_ms.
    tiers: Counts and processor time.
    """

    run: TimedRun
    host: Mapping[str, Any]
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
        is_whole = self.run.ended and not self.run.interrupted
        return is_whole and all(budget.passed for budget in self.budgets)

    @property
    def loop_ms(self) -> pd.Series:
        """How long the loop took, by cycle."""
        found = loop_ms(self.stages)
        return found.set_axis(self.stages.cycle).dropna()

    def document(self) -> dict[str, object]:
        """Return the content of the JSON."""
        return {
            "passed": self.passed,
            "run": self.run,
            "host": self.host,
            "clocks": self.clocks,
            "times": self.times.to_dict("records"),
            "tiers": self.tiers.to_dict("records"),
            "budgets": [{**one._asdict(), "passed": one.passed} for one in self.budgets],
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
        plan, limits, outcome = reader.plan, _budgets_in(reader), outcome_of(reader)
        metadata = reader.metadata["run"]
        stops = stops_of(reader.path.parent) if stops is None else stops
        stages = stage_table(reader, stops)
    summary = summary or outcome.document
    late, external, times = late_cycles(stages, plan), devices_of(stages, plan), statistics(stages)
    cycles = int(stages.cycle.max()) + 1
    wall_s, lost = cycles * plan.timing.cycle_wall_ns / 1e9, None
    remarks = [f"processor time and lost messages are not known: {outcome.undocumented}"]
    if summary is not None:
        wall_s, lost = summary.wall_s, summary.lost
        remarks = [*summary.remarks, *filter(None, [summary.recording_ended])]
    run_facts = TimedRun(
        scenario=plan.plant,
        run_id=plan.run_id,
        rate_hz=1e9 / plan.timing.cycle_wall_ns,
        planned_cycles=plan.timing.cycles,
        cycles=cycles,
        late_cycles=len(late),
        wall_s=wall_s,
        ended=outcome.stop_cycle is not None,
        interrupted=outcome._replace(document=summary).kind == "interrupted",
        lost_messages=lost,
    )
    tiers = _tiers(stages, summary, wall_s, plan)
    budgets = *_of_times(plan, limits, times), *_of_counts(limits, run_facts, tiers, external)
    return TimingReport(
        run=run_facts,
        host=_host(metadata, plan, load, stops),
        clocks=clocks_of(stages, plan),
        stages=stages,
        times=times,
        tiers=tiers,
        budgets=budgets,
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
    for agent in plan.tree.agents():
        kind = kind_of(agent, plan.tree)
        for stage in STAGES.get(kind, ()):
            slice_ms = plan.deadlines.slice_ns(agent, stage) / 1e6
            limit_ms = table.decision_p99_ms.get(kind, min(slice_ms, _PAPER_MS.get(kind, inf)))
            row = "decision", f"{tier_of(agent, plan.tree)} {stage}"
            if agent in plan.access.external:
                row = "response", f"{agent} {stage}"
            # Of a tier's processes the shortest limit counts.
            limits[row] = min(limit_ms, limits.get(row, inf))
    tick_ms = max(_LATENESS_SHARE * cycle_ms, _LEAST_LATENESS_MS)
    limits |= {("lateness", f"{PLANT} {stage}"): tick_ms for stage in STAGES["plant"]}
    for signal in SIGNALS:
        limit = table.hop_p99_ms.get(signal.name, signal.hop_p99_ms)
        if limit is not None:
            limits["hop", signal.name] = limit
    return limits


def _of_times(plan: RunPlan, table: BudgetTable, times: pd.DataFrame) -> Iterator[Budget]:
    """Yield the budgets of durations. What must be measured and was not is not kept."""
    rows = times[times.by == "tier"]
    measured = dict(zip(zip(rows.measure, rows.of, strict=True), rows.judged_ms, strict=True))
    for (measure, of), limit_ms in p99_limits_ms(plan, table).items():
        value = measured.get((measure, of))
        is_needed = measure in {"loop", "decision", "response"} or of in table.hop_p99_ms
        if value is not None or is_needed:
            yield Budget(f"{measure} {of} p99", measure, of, value, limit_ms, "ms")


def _of_counts(
    table: BudgetTable, run: TimedRun, tiers: pd.DataFrame, external: Sequence[DeviceTiming]
) -> Iterator[Budget]:
    """Yield the other budgets. A run whose losses are unknown is not clean."""

    def budget(line: str, value: float | None, limit: float, unit: str) -> Budget:
        return Budget(line, "", "", value, limit, unit)

    late_percent = 100.0 * run.late_cycles / run.cycles
    yield budget("late cycles", late_percent, table.late_cycles_percent, "%")
    for tier, percent in tiers.set_index("tier").cpu_highest_percent.dropna().items():
        limit = table.cpu_percent.get(str(tier).split(" ")[0], _CPU_PERCENT)
        yield budget(f"CPU of a {tier}", float(percent), limit, "%")
    for one in external:
        missed = f"late or silent {one.agent}"
        yield budget(missed, one.missed_percent, MOST_MISSED_PERCENT, "%")
        if one.stamps_off_ms == one.stamps_off_ms:
            yield budget(f"stamps of {one.agent}", one.stamps_off_ms, one.hop_p99_ms, "ms")
    yield budget("messages not recorded", run.lost_messages, table.lost_messages, "")


def _tiers(
    stages: pd.DataFrame, summary: RunDocument | None, wall_s: float, plan: RunPlan
) -> pd.DataFrame:
    """Count what was late by tier, and add up the processor time, which the launcher knows."""
    own = stages[~stages.device]
    # An agent that published nothing in a cycle has a row for each of its stages.
    counted = own[(own.late != SILENT) | ~own.duplicated(["cycle", "agent"])]
    late = pd.crosstab(counted.tier.astype(str), counted.late.astype(str))
    processes = [
        (tier_of(one.agent, plan.tree), 100.0 * (one.cpu_s or nan) / (wall_s or nan))
        for one in (summary.processes if summary else ())
    ]
    cpu = (
        pd.DataFrame(processes, columns=["tier", "cpu"]).astype({"cpu": float}).groupby("tier").cpu
    )
    found = pd.DataFrame({name: late.get(value, 0) for name, value in _COUNTS.items()}, late.index)
    found = found.join(cpu.agg(cpu_percent="sum", cpu_highest_percent="max"), how="outer")
    found[[*_COUNTS]] = found[[*_COUNTS]].fillna(0).astype(int)
    order = {tier: KINDS.index(tier.split(" ")[0]) for tier in found.index}
    return found.sort_index(key=lambda tiers: tiers.map(order)).rename_axis("tier").reset_index()


def _host(
    metadata: Mapping[str, str],
    plan: RunPlan,
    load: tuple[float, float] | None,
    stops: Sequence[MachineStop] | None,
) -> dict[str, Any]:
    machine = plan.supervision.machine
    bound = [*machine.cpus_of.items(), ("others" if machine.cpus_of else "all", machine.cpus)]
    before, after = load or (None, None)
    return {
        **{name: metadata.get(name, "unknown") for name in ("kernel", "cpu_count", "python")},
        "heliarch": metadata.get("version heliarch", "unknown"),
        "time_service": metadata.get("time_service", ""),
        "zenoh": metadata.get("version eclipse-zenoh", "unknown"),
        "priority": machine.priority or 0,
        "bound_to": {who: tuple(cpus) for who, cpus in bound if cpus},
        "load_before": before,
        "load_after": after,
        "stops": None if stops is None else len(stops),
        "longest_stop_ms": max((one.length_ms for one in stops or ()), default=0.0),
    }


def _budgets_in(reader: RunReader) -> BudgetTable:
    try:
        return msgspec.convert(reader.scenario_table().get("timing", {}), TimingTable).budgets
    except msgspec.ValidationError as error:
        raise InputError(f"{reader.path}: scenario.toml in it: {error}") from None
