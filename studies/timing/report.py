"""What a run in real time came to, as one document: all that table, page and JSON say."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from agents.events import ExternalAccount
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.summary import ProcessAccount, RunSummary
from launch_scripts.launcher.wrong_messages import WrongMessages
from launch_scripts.scenarios.budget_table import BudgetTable, TimingTable
from recordings.read.reader import RunReader
from studies.timing.budgets import Verdict, budgets_of, expected_rows, judge
from studies.timing.cycle_waits import CycleWaits
from studies.timing.floor import FloorTimes
from studies.timing.host import Host, recorded_host
from studies.timing.run_timing import RunTiming, Times, run_timing, tier_of
from studies.timing.tiers import TierAccount, cpu_percent, tier_accounts


class ProcessTimes(msgspec.Struct, frozen=True):
    """What one process came to; None stands for what only its launcher knew.

    Attributes
    ----------
    agent, tier
        Its name and tier.
    cpu_percent
        Processor time [% of one core].
    resident_mb
        Most memory that was seen resident [MB].
    voluntary_switches
        How often it waited for something, over its whole life.
    slowest_decision_us
        Its longest decision [us].
    missed_deadlines, overruns
        By stage.
    missing_inputs
        By port.
    old_inputs, skipped_cycles
        See `TierAccount`.
    dropped
        Messages that could not be used, by cause.
    times
        Its durations, row by row; empty unless `--processes` asked for them.
    """

    agent: str
    tier: str
    cpu_percent: float | None
    resident_mb: float | None
    voluntary_switches: int | None
    slowest_decision_us: float
    missed_deadlines: dict[str, int]
    overruns: dict[str, int]
    missing_inputs: dict[str, int]
    old_inputs: int
    skipped_cycles: int
    dropped: dict[str, int] | None
    times: tuple[Times, ...]


class SlowCycle(msgspec.Struct, frozen=True):
    """One of the slowest cycles, and what made it slow."""

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
    host
        What it was run on.
    rate_hz, cycles, wall_s
        Cycles a second, how many, and how long they took.
    interrupted
        Whether the user ended it early.
    remarks
        What is to be known of the run besides: what the machine did not permit, a recording that
        ended early.
    external
        What was heard of the user's own devices.
    wrong
        Messages of theirs that could not be used, by key and cause.
    faults
        What the faults of the network did to messages, if there were any.
    lost_messages
        Messages that were published and are not in the recording; None if it is not known.
    times
        Durations by tier and stage, and by signal, of all processes together.
    tiers
        Counts and shares by tier.
    processes
        Process by process.
    floor
        What the machine itself needs.
    slowest_cycles
        The slowest first.
    verdicts
        Budget by budget.
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
    tiers: tuple[TierAccount, ...]
    processes: tuple[ProcessTimes, ...]
    floor: tuple[FloorTimes, ...]
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

    def as_json(self) -> bytes:
        """Return the report as JSON, with the verdict on all of it."""
        document = {"passed": self.passed, "clean": self.clean, **msgspec.to_builtins(self)}
        return msgspec.json.format(msgspec.json.encode(document), indent=1)


class Reported(msgspec.Struct, frozen=True):
    """A report, and what its page draws besides: the waits of the slowest cycles."""

    report: TimingReport
    slowest: tuple[CycleWaits, ...]
    plan: RunPlan


def report_on(
    run: Path,
    summary: RunSummary | None = None,
    host: Host | None = None,
    floor: tuple[FloorTimes, ...] = (),
    *,
    by_agent: bool = False,
) -> Reported:
    """Work out the timing of a run from its recording.

    Parameters
    ----------
    run
        Its folder, or the MCAP file.
    summary
        Of the run. None: that in its folder, if there is one.
    host
        What it was run on. None: as far as the recording tells.
    floor
        What was measured of the machine beside it.
    by_agent
        Whether each process gets rows of its own.

    Raises
    ------
    InputError
        It is no recording of a run in real time, or it is damaged.
    """
    with RunReader(run) as reader:
        plan, table = reader.plan, budgets_in(reader)
        timing = run_timing(reader, by_agent=by_agent)
        folder, metadata = reader.path.parent, reader.metadata["run"]
    summary = summary or _summary_in(folder, plan)
    accounts = summary.processes if summary else ()
    wall_s = summary.wall_s if summary else timing.cycles * plan.cycle_wall_ns / 1e9
    lost = summary.lost if summary else None
    remarks = _remarks(summary)
    tiers = tier_accounts(timing.agents, accounts, wall_s, plan.tree)
    verdicts = judge(budgets_of(plan, table), timing.times, tiers, lost, _expected(plan, table))
    report = TimingReport(
        scenario=plan.plant,
        run_id=plan.run_id,
        folder=str(folder),
        host=host or recorded_host(plan, remarks, metadata),
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
        processes=_processes(timing, accounts, wall_s, plan),
        floor=floor,
        slowest_cycles=tuple(map(_slow_cycle, timing.slowest)),
        verdicts=verdicts,
    )
    return Reported(report, timing.slowest, plan)


def budgets_in(reader: RunReader) -> BudgetTable:
    """Return the budgets that the scenario of a recording states."""
    try:
        stated = tomllib.loads(reader.scenario).get("timing", {})
        return msgspec.convert(stated, TimingTable).budgets
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise InputError(f"{reader.path}: scenario.toml in it: {error}") from None


def _expected(plan: RunPlan, table: BudgetTable) -> set[tuple[str, str]]:
    return expected_rows(plan) | {("hop", signal) for signal in table.hop_p99_ms}


def _summary_in(folder: Path, plan: RunPlan) -> RunSummary | None:
    """Return the summary of a run in a folder; None if there is none of this run."""
    try:
        document = RunFolder(folder).summary.read_bytes()
        summary = msgspec.json.decode(document, type=RunSummary)
    except (OSError, msgspec.DecodeError):
        return None
    return summary if summary.run_id == plan.run_id else None


def _remarks(summary: RunSummary | None) -> tuple[str, ...]:
    if summary is None:
        return (
            "no summary.json of this run beside the recording: processor time, memory, dropped and "
            "lost messages are not known",
        )
    return (*summary.remarks, *filter(None, [summary.recording_ended]))


def _processes(
    timing: RunTiming, accounts: Sequence[ProcessAccount], wall_s: float, plan: RunPlan
) -> tuple[ProcessTimes, ...]:
    seen: Mapping[str, ProcessAccount] = {account.agent: account for account in accounts}
    found = []
    for agent, own in timing.agents.items():
        account = seen.get(agent)
        found.append(
            ProcessTimes(
                agent=agent,
                tier=tier_of(agent, plan.tree),
                cpu_percent=cpu_percent(account, wall_s) if account else None,
                resident_mb=account.resident_mb if account else None,
                voluntary_switches=account.voluntary_switches if account else None,
                slowest_decision_us=own.slowest_decision_ns / 1e3,
                missed_deadlines=dict(own.missed_deadlines),
                overruns=dict(own.overruns),
                missing_inputs=dict(own.missing_inputs),
                old_inputs=own.old_inputs,
                skipped_cycles=own.skipped_cycles,
                dropped=account.dropped if account else None,
                times=own.times,
            )
        )
    return tuple(found)


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
