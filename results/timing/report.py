"""The timing of one run: everything that tables, JSON and page show."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Final

import msgspec
import pandas as pd
from msgspec.structs import asdict, replace

from agents.process.machine import MachineSettings
from bus_schemas.errors import InputError
from bus_schemas.tree import ControlTree
from recordings.inspect.health import health_lines, summary_in
from recordings.inspect.overview import read_overview
from recordings.read.reader import RunReader
from results.run_summary import RunSummary
from results.timing.budgets import Verdict, judge
from results.timing.clocks import ClockOffset
from results.timing.cycle_waits import CycleWaits
from results.timing.run_timing import (
    ProcessTiming,
    TierTiming,
    Times,
    run_timing,
    tier_timings,
    with_accounts,
)
from scenarios.scenario import BudgetTable, TimingTable
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
    health: tuple[tuple[str, str], ...]
    devices: tuple[DeviceAccount, ...] = ()
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
        slowest = [
            {"cycle": one.cycle, "loop_us": one.loop_ns / 1e3, "text": one.in_words()}
            for one in self.slowest
        ]
        state = {"passed": self.passed, "clean": self.clean}
        return {**state, **fields, "slowest_cycles": slowest}


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
        ended, clock = reader.stop_cycle is not None, reader.clock
        health = summary.health if summary else None
        health = health or read_overview(reader).health
    summary = summary or summary_in(folder, plan, RunSummary)
    wall_s = timing.cycles * plan.timing.cycle_wall_ns / 1e9
    seen: dict[str, Any] = {"remarks": (_NO_SUMMARY,)}
    if summary is not None:
        wall_s = summary.wall_s
        accounts = with_accounts(timing.processes, summary.processes, wall_s, plan.tree)
        timing = timing._replace(processes=accounts)
        seen = {
            "remarks": (*summary.remarks, *filter(None, [summary.recording_ended])),
            "interrupted": summary.interrupted,
            "devices": summary.devices,
            "lost_messages": summary.lost,
        }
        health = replace(health, launcher=summary)
    tiers = tier_timings(timing.processes)
    return TimingReport(
        scenario=plan.plant,
        run_id=plan.run_id,
        folder=str(folder),
        host=Host(
            kernel=metadata.get("kernel", ""),
            cpus=int(metadata.get("cpu_count", "0")),
            scheduling=_scheduling(plan.supervision.machine),
            load_before=load[0] if load else None,
            load_after=load[1] if load else None,
            python=metadata.get("python", ""),
            heliarch=metadata.get("version heliarch", ""),
            zenoh=metadata.get("version eclipse-zenoh", ""),
        ),
        rate_hz=1e9 / plan.timing.cycle_wall_ns,
        cycles=timing.cycles,
        wall_s=wall_s,
        ended=ended,
        health=tuple(health_lines(health, clock)),
        tiers=tiers,
        verdicts=judge(plan, table, timing.times, tiers, seen.get("lost_messages")),
        tree=plan.tree,
        **timing._asdict(),
        **seen,
    )


def _scheduling(machine: MachineSettings) -> str:
    """Say what was asked of the machine; the remarks of the run say what it did not permit."""
    found = [f"SCHED_FIFO {machine.priority}" if machine.priority else "normal"]
    bound = [*machine.cpus_of.items(), ("others" if machine.cpus_of else "all", machine.cpus)]
    found += [f"{who} on CPU {', '.join(map(str, cpus))}" for who, cpus in bound if cpus]
    return ", ".join(found)


def _budgets_in(reader: RunReader) -> BudgetTable:
    try:
        stated = tomllib.loads(reader.scenario).get("timing", {})
        return msgspec.convert(stated, TimingTable).budgets
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, RecursionError) as error:
        raise InputError(f"{reader.path}: scenario.toml in it: {error}") from None
