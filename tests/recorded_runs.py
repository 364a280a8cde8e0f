"""Small runs in memory, in lockstep and over an imperfect network, as recordings."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np
from memory_runs import run_in_memory
from plans_by_hand import plan_at_noon
from recordings_by_hand import write_messages

from agents.faults import Fault
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.faults import Disturbance
from bus_schemas.signals import RUN
from bus_schemas.tree import PLANT
from recordings.read.run_file import RECORDING_NAME, further_file
from sim_plant.profile import PROFILE_NAME, Profile

TWO_TIERS: Final = {"c1/a": 100.0, "c1/b": 100.0, "c2/c": 120.0, "c2/d": 60.0}
THREE_TIERS: Final = {"z1/c1/a": 100.0, "z1/c1/b": 80.0, "z1/c2/c": 100.0, "z2/c3/d": 90.0}

AGENTS: Final = (PLANT, "central", "c1", "c2", *TWO_TIERS)
"""All agents of a run of two tiers that are re-run."""

CYCLE_WALL_NS: Final = 50_000_000


def plan_of(
    ratings_kw: dict[str, float] = TWO_TIERS, *, cycles: int = 12, **fields: object
) -> RunPlan:
    """Plan of a run, from the path and rating of each inverter; in lockstep by default."""
    predictive = {"scheme": "predictive", "correction": True}
    return plan_at_noon(ratings_kw, cycles=cycles, **(predictive | fields))


def faulty_plan(
    *rules: Fault,
    ratings_kw: dict[str, float] = TWO_TIERS,
    seed: int = 1,
    cycles: int = 25,
    **fields: object,
) -> RunPlan:
    """Plan of a run in real time over an imperfect network; by default a bad one."""
    faults = rules or (Disturbance(loss=0.05, duplicate=0.05, delay_ms=12.0, jitter_ms=12.0),)
    return plan_of(
        ratings_kw,
        cycles=cycles,
        cycle_wall_ns=CYCLE_WALL_NS,
        faults=faults,
        faults_seed=seed,
        **fields,
    )


def cloudy_profile(plan: RunPlan) -> Profile:
    """Each inverter between nothing and its rating, changing fast, so that many ask for help."""
    generator = np.random.default_rng(1)
    ratings_kw = np.array([rating_kw for _, rating_kw in plan.inverters])
    mpp_kw = ratings_kw * generator.uniform(0.0, 1.0, (plan.timing.cycles, len(ratings_kw)))
    # Now and then more than the plant's rating is dispatched: the central controller gives notice.
    dispatch_kw = ratings_kw.sum() * generator.uniform(0.2, 1.1, plan.timing.cycles)
    return Profile(mpp_kw, dispatch_kw)


def published(plan: RunPlan, profile: Profile) -> list[Delivery]:
    """All that is published in a run, in the order of a recorder."""
    return run_in_memory(plan, profile)[1].messages


def record(
    folder: Path, plan: RunPlan, messages: Iterable[Delivery], profile: Profile | None = None
) -> Path:
    """Write a recording into a folder, which is made if need be. Return the folder."""
    folder.mkdir(exist_ok=True)
    (folder / RECORDING_NAME).unlink(missing_ok=True)
    _write(folder / RECORDING_NAME, plan, messages)
    if profile is not None:
        profile.save(folder / PROFILE_NAME)
    return folder


def record_on(folder: Path, plan: RunPlan, messages: Iterable[Delivery], number: int = 2) -> None:
    """Write the file of a recorder that was started again."""
    _write(further_file(folder / RECORDING_NAME, number), plan, messages)


def _write(path: Path, plan: RunPlan, messages: Iterable[Delivery]) -> None:
    driver = "simulate" if plan.timing.lockstep else "launch"
    write_messages(path, messages, plan=plan, scenario='name = "oahu"\n', driver=driver)


def of_publisher(messages: Iterable[Delivery], agent: str) -> list[Delivery]:
    """What one agent decided."""
    return [pair for pair in messages if pair[0].publisher == agent and pair[0].signal is not RUN]
