"""The timing of one run as one document: everything that tables, JSON and page show."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec

from agents.events import ExternalAccount
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.summary import RunSummary
from launch_scripts.launcher.wrong_messages import WrongMessages
from launch_scripts.scenarios.budget_table import BudgetTable, TimingTable
from recordings.read.reader import RunReader
from studies.timing.budgets import Verdict, judge
from studies.timing.cycle_waits import CycleWaits
from studies.timing.host import Host, host_of
from studies.timing.processes import ProcessTiming, TierTiming, process_timings, tier_timings
from studies.timing.run_timing import RunTiming, Times, run_timing

_NO_SUMMARY = (
    "no summary.json of this run beside the recording: processor time, memory, dropped and lost "
    "messages are not known"
)


class SlowCycle(msgspec.Struct, frozen=True):
    """One of the slowest cycles, and the longest wait in it."""

    cycle: int
    loop_us: float
    slowest_agent: str
    slowest_stage: str
    slowest_us: float
    text: str


class TimingReport(msgspec.Struct, frozen=True):
    """A timed run.

    Attributes
    ----------
    scenario, run_id, folder
        What was run, and where its recording is.
    rate_hz, cycles, wall_s
        Cycles a second, how many the plant ended, and how long they took.
    interrupted
        Whether the user ended it early.
    remarks
        What a reader must know: what the machine did not permit, a recording that ended early.
    external, wrong
        What was heard of the user's own devices, and their messages that could not be used.
    faults
        What the network faults that were asked for did to messages.
    lost_messages
        Messages that were published and are not in the recording; None if not known.
    times
        Durations by tier and stage, and by signal.
    tiers, processes
        Counts and resources.
    slowest_cycles
        The slowest first.
    verdicts
        One for each budget.
    """

    scenario: str
    run_id: str
    folder: str
    host: Host
    rate_hz: float
    cycles: int
    wall_s: float
    interrupted: bool
    remarks: tuple[str, ...]
    external: tuple[ExternalAccount, ...]
    wrong: tuple[WrongMessages, ...]
    faults: dict[str, int]
    lost_messages: int | None
    times: tuple[Times, ...]
    tiers: tuple[TierTiming, ...]
    processes: tuple[ProcessTiming, ...]
    slowest_cycles: tuple[SlowCycle, ...]
    verdicts: tuple[Verdict, ...]

    @property
    def passed(self) -> bool:
        """Whether every budget was kept."""
        return all(verdict.passed for verdict in self.verdicts)

    @property
    def clean(self) -> bool:
        """Whether the plant kept up: no deadline missed, no overrun, nothing skipped or lost."""
        late = sum(
            tier.missed_deadlines + tier.overruns + tier.skipped_cycles for tier in self.tiers
        )
        return self.cycles > 0 and late == 0 and not self.lost_messages

    def document(self) -> dict[str, object]:
        """Return the report for other programs, with the verdict on all of it."""
        return {"passed": self.passed, "clean": self.clean, **msgspec.structs.asdict(self)}


class Reported(msgspec.Struct, frozen=True):
    """A report, and what its page draws besides."""

    report: TimingReport
    timing: RunTiming
    plan: RunPlan


def report_on(
    run: Path,
    summary: RunSummary | None = None,
    load: tuple[float, float] | None = None,
    *,
    by_agent: bool = False,
) -> Reported:
    """Work out the timing of a run from its recording.

    Parameters
    ----------
    run
        Its folder, or the MCAP file.
    summary
        Of the run; by default the one in its folder, if there is one.
    load
        Load average of the machine before and after it, if known.
    by_agent
        Whether each process gets rows of durations of its own.

    Raises
    ------
    InputError
        It is no recording of a run in real time, or it is damaged.
    """
    with RunReader(run) as reader:
        plan, table = reader.plan, _budgets_in(reader)
        timing = run_timing(reader, by_agent=by_agent)
        folder, metadata = reader.path.parent, reader.metadata["run"]
    summary = summary or _summary_in(folder, plan)
    remarks: tuple[str, ...] = (_NO_SUMMARY,)
    if summary:
        remarks = (*summary.remarks, *filter(None, [summary.recording_ended]))
    lost = summary.lost if summary else None
    wall_s = summary.wall_s if summary else timing.cycles * plan.cycle_wall_ns / 1e9
    accounts = summary.processes if summary else ()
    processes = process_timings(timing.agents, accounts, wall_s, plan.tree)
    tiers = tier_timings(processes)
    report = TimingReport(
        scenario=plan.plant,
        run_id=plan.run_id,
        folder=str(folder),
        host=host_of(plan, metadata, remarks, load),
        rate_hz=1e9 / plan.cycle_wall_ns,
        cycles=timing.cycles,
        wall_s=wall_s,
        interrupted=summary.interrupted if summary else False,
        remarks=remarks,
        external=summary.external if summary else (),
        wrong=summary.wrong if summary else (),
        faults=summary.faults if summary else {},
        lost_messages=lost,
        times=timing.times,
        tiers=tiers,
        processes=processes,
        slowest_cycles=tuple(map(_slow_cycle, timing.slowest)),
        verdicts=judge(plan, table, timing.times, tiers, lost),
    )
    return Reported(report, timing, plan)


def _budgets_in(reader: RunReader) -> BudgetTable:
    try:
        stated = tomllib.loads(reader.scenario).get("timing", {})
        return msgspec.convert(stated, TimingTable).budgets
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise InputError(f"{reader.path}: scenario.toml in it: {error}") from None


def _summary_in(folder: Path, plan: RunPlan) -> RunSummary | None:
    """Return the summary in a folder; None if there is none of this run."""
    try:
        document = RunFolder(folder).summary.read_bytes()
        summary = msgspec.json.decode(document, type=RunSummary)
    except (OSError, msgspec.DecodeError):
        return None
    return summary if summary.run_id == plan.run_id else None


def _slow_cycle(cycle: CycleWaits) -> SlowCycle:
    slowest = cycle.slowest
    return SlowCycle(
        cycle.cycle,
        cycle.loop_ns / 1e3,
        slowest.agent,
        slowest.stage,
        slowest.length_ns / 1e3,
        cycle.in_words(),
    )
