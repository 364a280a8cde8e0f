"""Reports on recordings made by hand, with the summary of a launcher that saw nothing unusual."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from recordings_by_hand import SCENARIO
from timed_recordings import PLAN, TIMES_MS, cycle, recorded

from agents.cycle import kind_of
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from results.run_document import (
    MessageCount,
    ProcessAccount,
    RunDocument,
)
from results.timing.report import TimingReport, report_on

LOAD = (0.5, 0.75)

MISSED = {**TIMES_MS, "production": (PLAN.deadlines.deadline_ns("plant", "apply") / 1e6, 95.0)}
MISSED.pop("c2/d/command")


def missed(number: int) -> Iterable[Delivery]:
    """A cycle in which the command of `c2/d` never came."""
    return cycle(number, MISSED, {"production": ("c2/d/command",)})


def summary_of(folder: Path, plan: RunPlan = PLAN, *, lost: int = 0) -> RunDocument:
    """The summary of a run in this folder that took 10 s: each process 1 s of processor time."""
    accounts = [
        ProcessAccount(agent, kind_of(agent, plan.tree), {}, 40.0, cpu_s=1.0)
        for agent in plan.tree.agents()
        if agent not in plan.access.external
    ]
    return RunDocument(
        run_id=plan.run_id,
        scenario=plan.plant,
        driver="launch",
        folder=str(folder),
        sim_start="",
        planned_cycles=2,
        cycle_s=0.1,
        cycles=2,
        wall_s=10.0,
        messages=(MessageCount("impp", 10 + lost, 10),),
        processes=tuple(accounts),
    )


def reported(
    folder: Path,
    *cycles: Iterable[Delivery],
    budgets: str = "",
    lost: int = 0,
    plan: RunPlan = PLAN,
) -> TimingReport:
    """A report on these cycles (default: two good ones) against the budgets of a TOML table."""
    folder.mkdir(exist_ok=True)
    scenario = f"{SCENARIO}[timing.budgets]\n{budgets}\n"
    recorded(folder, *(cycles or (cycle(0), cycle(1))), plan=plan, scenario=scenario)
    summary = summary_of(folder, plan, lost=lost)
    return report_on(folder, summary, LOAD)
