"""Recordings for replays: a run in memory of a plant of four inverters, a message every 0.1 ms."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace
from plans_by_hand import FOUR
from recorded_runs import cloudy_profile, plan_of, published
from recordings_by_hand import write_messages

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Port

STEP_NS = 100_000

PLAN = plan_of(
    FOUR,
    cycles=40,
    period_cycles=(2, 1),
    run_id="recorded-1",
    plant="field",
    stall_timeout_s=0.5,
    correction=False,
)
CYCLE_NS = PLAN.timing.cycle_ns


class Said(NamedTuple):
    """A message as it is written: when it was published and recorded, monotonic [ns]."""

    port: Port[Message]
    message: Message
    logged_ns: int


def run_in_memory(plan: RunPlan = PLAN) -> list[Said]:
    """All that is said in a run."""
    return [
        Said(port, replace(message, publish_time_ns=place * STEP_NS), place * STEP_NS + 1_000)
        for place, (port, message) in enumerate(published(plan, cloudy_profile(plan)), start=1)
    ]


def write(folder: Path, said: Iterable[Said], plan: RunPlan = PLAN) -> Path:
    """Write a recording; return the folder of its run."""
    folder.mkdir(parents=True, exist_ok=True)
    write_messages(folder / "run.mcap", said, plan=plan, messages_per_chunk=100)
    return folder
