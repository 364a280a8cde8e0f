"""The summary of a run over processes: their own accounts, the recorder's, and the clock's."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from msgspec.structs import replace

from agents.events import Finished, Recorded
from agents.plan import RunPlan
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.summary import (
    MemoryUse,
    ProcessAccount,
    RunSummary,
    count_messages,
    memory_use,
    merge_counts,
    recorded_metrics,
    without_external,
)
from launch_scripts.launcher.supervision import Child, Memory
from launch_scripts.launcher.wrong_messages import wrong_messages
from launch_scripts.scenarios.preparation import Preparation


class LaunchAccount(NamedTuple):
    """What the launcher saw of a run from outside.

    Attributes
    ----------
    began_at, armed_at, ended_at
        Monotonic time of the command, of cycle 0 and of the end [s].
    arming_rounds
        How many it took.
    started_at
        Monotonic time at which the processes were asked for [s].
    cpu_at_start_s
        Processor time of each agent's process when cycle 0 began [s].
    refusals
        What was asked of the machine and not permitted.
    """

    began_at: float
    armed_at: float
    ended_at: float
    arming_rounds: int
    started_at: float
    cpu_at_start_s: dict[str, float | None]
    refusals: tuple[str, ...]


def launch_summary(
    preparation: Preparation,
    plan: RunPlan,
    folder: RunFolder,
    children: Collection[Child],
    recorded: Recorded,
    seen: LaunchAccount,
    *,
    interrupted: bool,
) -> RunSummary:
    """Bring together what a run came to.

    Parameters
    ----------
    preparation, plan, folder
        The run.
    children
        Its processes, all at their end.
    recorded
        The recorder's account.
    seen
        The launcher's.
    interrupted
        Whether the user ended the run.
    """
    accounts = [child.finished for child in children if child.finished is not None]
    team, cycles = _together(accounts), recorded.cycles
    at_recorder = {"at the recorder": recorded.foreign} if recorded.foreign else {}
    return RunSummary(
        run_id=plan.run_id,
        scenario=plan.plant,
        driver="launch",
        folder=str(folder.path),
        sim_start=preparation.local_start(),
        cycles=cycles,
        cycle_s=plan.cycle_ns / 1e9,
        # In real time the last cycle lasts to its end, though all have done their part before.
        wall_s=max(seen.ended_at - seen.armed_at, cycles * plan.cycle_wall_ns / 1e9),
        startup_s=seen.armed_at - seen.began_at,
        arming_rounds=seen.arming_rounds,
        metrics=recorded_metrics(folder.recording),
        messages=count_messages(team.published, without_external(recorded)),
        dropped=_by_cause(accounts) | at_recorder,
        missing_inputs=team.missing_inputs,
        memory=_memory(children),
        hindsight_neighbours=preparation.hindsight,
        remarks=(*preparation.remarks, *seen.refusals),
        interrupted=interrupted,
        recording_ended=recorded.ended_early,
        faults=team.faults,
        old_inputs=team.old_inputs,
        skipped_cycles=team.skipped_cycles,
        processes_startup_s=seen.armed_at - seen.started_at,
        processes=tuple(_account(child, seen.cpu_at_start_s) for child in children),
        external=recorded.external,
        wrong=wrong_messages(plan, recorded.complaints, [account.dropped for account in accounts]),
    )


def _together(accounts: Sequence[Finished]) -> Finished:
    """Add up what processes said at their end."""
    return Finished(
        published=merge_counts([account.published for account in accounts]),
        dropped={},
        missing_inputs=sum(account.missing_inputs for account in accounts),
        old_inputs=sum(account.old_inputs for account in accounts),
        skipped_cycles=sum(account.skipped_cycles for account in accounts),
        faults=merge_counts([account.faults for account in accounts]),
    )


def _memory(children: Collection[Child]) -> tuple[MemoryUse, ...]:
    samples: dict[str, list[Memory]] = {}
    for child in children:
        samples.setdefault(child.kind, []).append(child.memory)
    return memory_use(samples)


def _by_cause(accounts: Sequence[Finished]) -> dict[str, int]:
    """Add up the messages that were not used, by cause."""
    return merge_counts([causes for account in accounts for causes in account.dropped.values()])


def _account(child: Child, cpu_at_start_s: Mapping[str, float | None]) -> ProcessAccount:
    """Return the account of a process."""
    name, finished = child.agent, child.finished
    at_start_s, at_end_s = cpu_at_start_s.get(name), child.cpu_s()
    account = ProcessAccount(
        name,
        child.kind,
        dropped={},
        resident_mb=child.memory.resident_mb,
        cpu_s=None if at_start_s is None or at_end_s is None else at_end_s - at_start_s,
        voluntary_switches=child.exited.voluntary_switches if child.exited else 0,
    )
    if finished is None:
        return account
    return replace(
        account,
        dropped=_by_cause([finished]),
        missing_inputs=finished.missing_inputs,
        old_inputs=finished.old_inputs,
        skipped_cycles=finished.skipped_cycles,
    )
