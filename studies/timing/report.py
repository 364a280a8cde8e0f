"""The timing of one run: everything that tables, JSON and page show."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import pandas as pd
from msgspec.structs import asdict

from agents.events import ExternalAccount
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.tree import ControlTree
from launch_scripts.launcher.summary import RunSummary
from launch_scripts.scenarios.scenario import BudgetTable, TimingTable
from recordings.inspect.health import WrongMessages, summary_in
from recordings.read.reader import RunReader
from studies.timing.budgets import Verdict, judge
from studies.timing.clocks import ClockOffset
from studies.timing.cycle_waits import CycleWaits
from studies.timing.durations import Times
from studies.timing.run_timing import (
    ProcessTiming,
    TierTiming,
    run_timing,
    tier_timings,
    with_accounts,
)
from sunspec.process import DeviceAccount

_CLEAN_SHARE: Final = 0.01
"""Share of late cycles up to which a run is clean: one long stall must not decide."""

_NO_SUMMARY = (
    "no summary.json of this run beside the recording: processor time, memory, dropped and lost "
    "messages are not known"
)


class Host(msgspec.Struct, frozen=True, kw_only=True):
    """The machine and the software of a timed run: the figures mean nothing without them."""

    kernel: str
    cpus: int
    scheduling: str
    load_before: float | None
    load_after: float | None
    python: str
    heliarch: str
    zenoh: str


class TimingReport(msgspec.Struct, frozen=True, kw_only=True):
    """A timed run; docs/timing.md describes the fields. None: it is not known.

    `ended` is false if the recording does not show that the plant ended the run. Only the page uses
    `loop_ns`, the loop time of each cycle, and `tree`, for the order of its rows.
    """

    scenario: str
    run_id: str
    folder: str
    host: Host
    rate_hz: float
    cycles: int
    late_cycles: int
    wall_s: float
    ended: bool = True
    interrupted: bool = False
    remarks: tuple[str, ...]
    external: tuple[ExternalAccount, ...] = ()
    devices: tuple[DeviceAccount, ...] = ()
    wrong: tuple[WrongMessages, ...] = ()
    faults: dict[str, int] = {}
    lost_messages: int | None = None
    clocks: tuple[ClockOffset, ...] = ()
    times: tuple[Times, ...]
    tiers: tuple[TierTiming, ...]
    processes: tuple[ProcessTiming, ...]
    verdicts: tuple[Verdict, ...]
    slowest: tuple[CycleWaits, ...]
    loop_ns: pd.Series
    tree: ControlTree

    @property
    def passed(self) -> bool:
        """Whether every budget was kept up to the end of the run."""
        return self.ended and all(verdict.passed for verdict in self.verdicts)

    @property
    def clean(self) -> bool:
        """Whether the plant kept up: at most 1 % of the cycles were late, and nothing was lost."""
        few_late = self.late_cycles <= _CLEAN_SHARE * self.cycles
        return self.ended and self.cycles > 0 and few_late and not self.lost_messages

    def document(self) -> dict[str, object]:
        """Return the content of the JSON."""
        own = ("slowest", "loop_ns", "tree")
        fields = {name: value for name, value in asdict(self).items() if name not in own}
        slowest_cycles = [
            {
                "cycle": one.cycle,
                "loop_us": one.loop_ns / 1e3,
                "slowest_agent": one.slowest.agent,
                "slowest_stage": one.slowest.stage,
                "slowest_us": one.slowest.length_ns / 1e3,
                "text": one.in_words(),
            }
            for one in self.slowest
        ]
        state = {"passed": self.passed, "clean": self.clean}
        return {**state, **fields, "slowest_cycles": slowest_cycles}


def report_on(
    run: Path,
    summary: RunSummary | None = None,
    load: tuple[float, float] | None = None,
    *,
    by_agent: bool = False,
) -> TimingReport:
    """Work out the timing of a run from its recording.

    Without a summary the one in the run's folder is used, if there is one. `load` is the machine's
    load average before and after the run. With `by_agent` each process has rows of its own.
    """
    with RunReader(run) as reader:
        plan, table = reader.plan, _budgets_in(reader)
        timing = run_timing(reader, by_agent=by_agent)
        folder, metadata = reader.path.parent, reader.metadata["run"]
        ended = reader.stop_cycle is not None
    summary = summary or summary_in(folder, plan, RunSummary)
    remarks: tuple[str, ...] = (_NO_SUMMARY,)
    wall_s = timing.cycles * plan.cycle_wall_ns / 1e9
    seen: dict[str, Any] = {}
    if summary is not None:
        remarks = (*summary.remarks, *filter(None, [summary.recording_ended]))
        wall_s = summary.wall_s
        accounts = with_accounts(timing.processes, summary.processes, wall_s, plan.tree)
        timing = timing._replace(processes=accounts)
        names = ("interrupted", "external", "devices", "wrong", "faults")
        seen = {name: getattr(summary, name) for name in names} | {"lost_messages": summary.lost}
    tiers = tier_timings(timing.processes)
    return TimingReport(
        scenario=plan.plant,
        run_id=plan.run_id,
        folder=str(folder),
        host=_host(plan, metadata, remarks, load),
        rate_hz=1e9 / plan.cycle_wall_ns,
        cycles=timing.cycles,
        wall_s=wall_s,
        ended=ended,
        remarks=remarks,
        tiers=tiers,
        verdicts=judge(plan, table, timing.times, tiers, seen.get("lost_messages")),
        tree=plan.tree,
        **timing._asdict(),
        **seen,
    )


def _host(
    plan: RunPlan,
    run: Mapping[str, str],
    remarks: Sequence[str],
    load: tuple[float, float] | None,
) -> Host:
    """Describe the machine; the remarks say what it did not permit."""
    before, after = load or (None, None)
    machine = plan.machine
    fifo = machine.priority and not any("SCHED_FIFO" in remark for remark in remarks)
    scheduling = [f"SCHED_FIFO {machine.priority}" if fifo else "normal"]
    bound: dict[str, tuple[int, ...]] = dict(machine.cpus_of.items())
    if machine.cpus:
        bound["others" if bound else "all"] = machine.cpus
    scheduling += [f"{who} on CPU {', '.join(map(str, cpus))}" for who, cpus in bound.items()]
    return Host(
        kernel=run.get("kernel", ""),
        cpus=int(run.get("cpu_count", "0")),
        scheduling=", ".join(scheduling),
        load_before=before,
        load_after=after,
        python=run.get("python", ""),
        heliarch=run.get("version heliarch", ""),
        zenoh=run.get("version eclipse-zenoh", ""),
    )


def _budgets_in(reader: RunReader) -> BudgetTable:
    try:
        stated = tomllib.loads(reader.scenario).get("timing", {})
        return msgspec.convert(stated, TimingTable).budgets
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, RecursionError) as error:
        raise InputError(f"{reader.path}: scenario.toml in it: {error}") from None
