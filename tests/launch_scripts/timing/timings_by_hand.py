"""What processes of a small plant could have measured of themselves, and reports on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from msgspec.structs import replace
from recordings_by_hand import PLAN

from agents.histograms import HIGHEST_NS, Extremes, new_histogram, record_ns
from agents.plan import RunPlan
from agents.stopwatch import ProcessTiming
from bus_schemas.tree import ControlTree
from launch_scripts.summary import ProcessAccount, RunSummary
from launch_scripts.timing.budget_table import BudgetTable
from launch_scripts.timing.budgets import budgets_of, judge
from launch_scripts.timing.floor import FloorTimes
from launch_scripts.timing.host import Host
from launch_scripts.timing.measures import Tiers, tier_accounts, times_by_tier, times_of
from launch_scripts.timing.timing_report import ProcessTimes, SlowCycle, TimingReport

TREE: ControlTree = PLAN.tree
"""Four inverters, `c1/a` to `c2/d`, in two clusters."""

REAL_TIME: RunPlan = replace(PLAN, cycle_wall_ns=80_000_000)
"""Cycles of 80 ms: between the deadlines of two tiers lie 9 ms."""

DEFAULTS = BudgetTable()

HOST = Host("Linux 6", "A processor", 2, ("other on CPU 0, 1",), 0.5, 0.75, "3.11", "0.1", "1.10")


def encoded(times_ms: Sequence[float]) -> str:
    """A histogram of these durations."""
    histogram = new_histogram()
    for time_ms in times_ms:
        record_ns(histogram, round(time_ms * 1e6))
    text: str = histogram.encode().decode("ascii")
    return text


def extremes(times_ms: Sequence[float]) -> Extremes:
    """The least and the greatest of these durations, as a process keeps them: up to an hour."""
    ns = [min(round(time_ms * 1e6), HIGHEST_NS) for time_ms in times_ms]
    return Extremes(min(ns), max(ns))


def timing(
    agent: str,
    measures_ms: Mapping[str, Sequence[float]],
    *,
    missed: int = 0,
    overruns: int = 0,
    cpu_s: float = 1.0,
) -> ProcessTiming:
    """What a process measured in 10 s."""
    return ProcessTiming(
        agent=agent,
        histograms={name: encoded(times_ms) for name, times_ms in measures_ms.items()},
        missed_deadlines={"estimate": missed} if missed else {},
        missing_inputs={"c1/a/request": 2 * missed} if missed else {},
        overruns={"estimate": overruns} if overruns else {},
        late_used=missed,
        cpu_s=cpu_s,
        wall_s=10.0,
        switches_voluntary=100,
        switches_involuntary=5,
        resident_mb=40.0,
        policy="other on CPU 0, 1",
        extremes={name: extremes(times_ms) for name, times_ms in measures_ms.items()},
    )


TIMINGS = (
    timing(
        "plant",
        {
            "decision/begin": [1.0],
            "decision/advance": [2.0],
            "lateness/begin": [0.5],
            "jitter/begin": [0.25],
            "loop": [20.0, 30.0],
            "loop/c1/a": [18.0, 19.0],
            "loop/c2/d": [20.0, 30.0],
            "hop/c1/a/command": [1.0],
            "hop/c2/d/command": [3.0],
        },
    ),
    timing("central", {"decision/solve": [1.5], "hop/c1/impp": [1.0], "hop/c2/impp": [2.0]}),
    timing("c1", {"decision/report": [0.5], "hop/c1/a/impp": [4.0]}),
    timing("c1/a", {"decision/estimate": [5.0], "age/estimate": [7.0]}, cpu_s=2.0),
    timing("c2/d", {"decision/estimate": [6.0]}, cpu_s=3.0),
)


def account(found: ProcessTiming, dropped: int = 0) -> ProcessAccount:
    """The account of a process at the end of a run."""
    kind = Tiers(TREE).kind(found.agent)
    return ProcessAccount(found.agent, kind, {"late": dropped} if dropped else {}, 40.0, found)


def summary_of(folder: Path, *, interrupted: bool, recording_ended: str = "") -> RunSummary:
    """The summary of a run in this folder."""
    return RunSummary(
        run_id="by-hand",
        scenario="field",
        driver="launch",
        folder=str(folder),
        sim_start="",
        cycles=3,
        cycle_s=0.08,
        wall_s=0.24,
        startup_s=0.0,
        arming_rounds=1,
        metrics=None,
        messages=(),
        dropped={},
        missing_inputs=0,
        memory=(),
        hindsight_neighbours=False,
        remarks=(),
        interrupted=interrupted,
        recording_ended=recording_ended,
    )


def report(
    timings: Sequence[ProcessTiming] = TIMINGS,
    table: BudgetTable = DEFAULTS,
    *,
    lost: int = 0,
    cycles: int = 2,
    floor: tuple[FloorTimes, ...] = (),
) -> TimingReport:
    """A report on what these processes measured."""
    accounts = [account(found) for found in timings]
    times, tiers = times_by_tier(timings, TREE), tier_accounts(accounts, TREE)
    return TimingReport(
        scenario="field",
        run_id="by-hand-2",
        folder="runs/by-hand-2",
        host=HOST,
        rate_hz=12.5,
        cycles=cycles,
        wall_s=0.2,
        interrupted=False,
        remarks=(),
        external=(),
        wrong=(),
        faults={},
        lost_messages=lost,
        times=times,
        tiers=tiers,
        processes=tuple(
            ProcessTimes(
                found.agent,
                Tiers(TREE).tier(found.agent),
                found.policy,
                10.0 * found.cpu_s,
                found.resident_mb,
                found.switches_voluntary,
                found.switches_involuntary,
                found.missed_deadlines,
                found.overruns,
                found.missing_inputs,
                found.late_used,
                0,
                {},
                times_of(found, TREE),
            )
            for found in timings
        ),
        floor=floor,
        slowest_cycles=(
            SlowCycle(1, 30_000.0, "c2/d", "estimate", 6_500.0, "cycle 1: 30.0 ms, c2/d took it"),
        ),
        verdicts=judge(budgets_of(REAL_TIME, table), times, tiers, lost, set()),
    )
