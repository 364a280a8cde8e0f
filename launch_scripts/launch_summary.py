"""The summary of a run over processes: their own accounts, the recorder's, and the clock's."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

from msgspec.structs import replace

from agents.events import Finished, Recorded
from agents.plan import RunPlan
from bus_schemas.tree import RECORDER
from launch_scripts.preparation import Preparation
from launch_scripts.run_folder import RunFolder
from launch_scripts.summary import (
    MemoryUse,
    ProcessAccount,
    RunSummary,
    count_messages,
    memory_use,
    merge_counts,
    plant_metrics,
    without_external,
)
from launch_scripts.supervision import Child, Memory
from launch_scripts.wrong_messages import wrong_messages


class LaunchAccount(NamedTuple):
    """What the launcher saw of a run from outside.

    Attributes
    ----------
    began_at, armed_at, ended_at
        Monotonic time of the command, of cycle 0 and of the end [s].
    arming_rounds
        How many it took.
    recorder_percent
        The recorder's processor time [% of one core]; None if it is not known.
    refusals
        What was asked of the machine and not permitted.
    """

    began_at: float
    armed_at: float
    ended_at: float
    arming_rounds: int
    recorder_percent: float | None
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
    team, cycles = _together(accounts), len(recorded.plant.desired_kw)
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
        metrics=plant_metrics(plan, recorded.plant),
        messages=count_messages(team.published, without_external(recorded)),
        dropped=team.dropped | at_recorder,
        missing_inputs=team.missing_inputs,
        memory=_memory(children),
        hindsight_neighbours=preparation.hindsight,
        remarks=(*preparation.remarks, *seen.refusals),
        interrupted=interrupted,
        recording_ended=recorded.ended_early,
        faults=team.faults,
        late_used=team.late_used,
        cycles_given_up=team.skipped_cycles,
        processes=tuple(_account(child, seen.recorder_percent) for child in children),
        external=recorded.external,
        wrong=wrong_messages(
            plan, recorded.complaints, [account.dropped_ports for account in accounts]
        ),
    )


def _together(accounts: Sequence[Finished]) -> Finished:
    """Add up what processes said at their end."""
    return Finished(
        published=merge_counts([account.published for account in accounts]),
        dropped=merge_counts([account.dropped for account in accounts]),
        missing_inputs=sum(account.missing_inputs for account in accounts),
        late_used=sum(account.late_used for account in accounts),
        skipped_cycles=sum(account.skipped_cycles for account in accounts),
        faults=merge_counts([account.faults for account in accounts]),
    )


def _memory(children: Collection[Child]) -> tuple[MemoryUse, ...]:
    samples: dict[str, list[Memory]] = {}
    for child in children:
        samples.setdefault(child.spec.kind, []).append(child.memory)
    return memory_use(samples)


def _account(child: Child, recorder_percent: float | None) -> ProcessAccount:
    """Return the account of a process. The recorder does not measure itself."""
    name, resident_mb = child.spec.agent, child.memory.resident_mb
    account = ProcessAccount(name, child.spec.kind, dropped={}, resident_mb=resident_mb)
    if name == RECORDER:
        account = replace(account, cpu_percent=recorder_percent)
    if child.finished is None:
        return account
    return replace(
        account,
        dropped=child.finished.dropped,
        timing=child.finished.timing,
        cycles_given_up=child.finished.skipped_cycles,
    )
