"""The machine and the software of a timed run: the figures mean nothing without them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from agents.plan import RunPlan


class Host(msgspec.Struct, frozen=True):
    """Where a run was timed.

    Attributes
    ----------
    kernel
        Its name and release; empty if not known.
    cpus
        Number of processors.
    scheduling
        Policy and processors of plant and controllers: `SCHED_FIFO 20`.
    load_before, load_after
        Load average of the last minute; None if not known.
    python, heliarch, zenoh
        Versions.
    memory_locked
        Whether the memory of plant and controllers was never paged out.
    """

    kernel: str
    cpus: int
    scheduling: str
    load_before: float | None
    load_after: float | None
    python: str
    heliarch: str
    zenoh: str
    memory_locked: bool = False


def host_of(
    plan: RunPlan,
    run: Mapping[str, str],
    remarks: Sequence[str],
    load: tuple[float, float] | None,
) -> Host:
    """Describe the machine of a run.

    Parameters
    ----------
    plan
        Of the run.
    run
        The recording's metadata of that name.
    remarks
        Of the run: they say what the machine did not permit.
    load
        Load average before and after the run; None if not known.
    """
    before, after = load or (None, None)
    refused = any(remark.startswith("memory: ") for remark in remarks)
    return Host(
        kernel=run.get("kernel", ""),
        cpus=int(run.get("cpu_count", "0")),
        scheduling=_scheduling(plan, remarks),
        load_before=before,
        load_after=after,
        python=run.get("python", ""),
        heliarch=run.get("version heliarch", ""),
        zenoh=run.get("version eclipse-zenoh", ""),
        memory_locked=plan.machine.lock_memory and not refused,
    )


def _scheduling(plan: RunPlan, remarks: Sequence[str]) -> str:
    machine = plan.machine
    fifo = machine.priority and not any("SCHED_FIFO" in remark for remark in remarks)
    policy = f"SCHED_FIFO {machine.priority}" if fifo else "normal"
    bound = [f"{kind} on CPU {_listed(cpus)}" for kind, cpus in machine.cpus_of.items()]
    if machine.cpus:
        bound.append(f"{'others' if bound else 'all'} on CPU {_listed(machine.cpus)}")
    return ", ".join([policy, *bound])


def _listed(cpus: Sequence[int]) -> str:
    return ", ".join(map(str, cpus))
