"""Recordings in real time made by hand: four inverters, and the times of each message stated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path

from msgspec.structs import replace
from plans_by_hand import plan_at_noon, with_changes
from recordings_by_hand import SCENARIO, cycle_of_the_plant, write_messages

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message, Run
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import ROOT
from recordings.record.writer import ClockAnchor

MS = 1_000_000
START_NS = 5_000_000_000
CYCLE_MS = 100

PLAN = plan_at_noon(
    run_id="by-hand-2",
    plant="field",
    cycles=1000,
    cycle_ns=CYCLE_MS * MS,
    cycle_wall_ns=CYCLE_MS * MS,
)

TIMES_MS = {
    # When the stage could close, and when the message went out.
    "dispatch": (0.0, 0.9),
    "meter": (0.0, 0.95),
    "c1/a/telemetry": (0.0, 1.0),
    "c1/b/telemetry": (0.0, 1.1),
    "c2/c/telemetry": (0.0, 1.2),
    "c2/d/telemetry": (0.0, 1.3),
    "c1/a/impp": (2.0, 4.0),
    "c1/a/residual": (2.0, 4.1),
    "c1/a/help": (2.0, 4.15),
    "c1/b/impp": (2.1, 4.2),
    "c1/b/residual": (2.1, 4.3),
    "c2/c/impp": (2.2, 9.0),
    "c2/c/residual": (2.2, 9.1),
    "c2/d/impp": (2.3, 4.4),
    "c2/d/residual": (2.3, 4.5),
    "c1/impp": (4.6, 5.0),
    "c1/residual": (4.6, 5.1),
    "c2/impp": (9.6, 10.0),
    "c2/residual": (9.6, 10.1),
    "impp": (10.5, 11.0),
    "residual": (10.5, 11.1),
    "c1/setpoint": (10.5, 11.5),
    "c2/setpoint": (10.5, 11.6),
    "c1/a/setpoint": (11.8, 12.0),
    "c1/b/setpoint": (11.8, 12.1),
    "c2/c/setpoint": (11.9, 12.2),
    "c2/d/setpoint": (11.9, 12.3),
    "c1/a/command": (12.4, 13.0),
    "c1/b/command": (12.5, 13.1),
    "c2/c/command": (12.6, 13.2),
    "c2/d/command": (12.7, 13.4),
    "production": (13.6, 14.0),
}
"""A cycle of 14 ms in which `c2/c` is slow to estimate: everybody waits for it but c1."""

PLAIN = {str(port): (port, message) for port, message in cycle_of_the_plant(0)}
"""A message of each port."""

Times = Mapping[str, tuple[float, float]]


def cycle(
    number: int,
    times_ms: Times = TIMES_MS,
    missing: Mapping[str, tuple[str, ...]] = {},
    plan: RunPlan = PLAN,
) -> Iterator[Delivery]:
    """The messages of a cycle, in the order of their times; what has none is not said."""
    tick_ns = START_NS + number * CYCLE_MS * MS
    for key, (ready_ms, publish_ms) in sorted(times_ms.items(), key=lambda entry: entry[1][1]):
        port, message = PLAIN[key]
        yield (
            port,
            replace(
                message,
                cycle=number,
                sim_time_ns=plan.timing.sim_time_ns(number),
                missing=missing.get(key, ()),
                ready_time_ns=round(tick_ns + ready_ms * MS),
                publish_time_ns=round(tick_ns + publish_ms * MS),
                sequence=number,
            ),
        )


def without(*keys: str) -> dict[str, tuple[float, float]]:
    """The times of all messages but these."""
    return {key: times for key, times in TIMES_MS.items() if key not in keys}


def recorded(
    folder: Path,
    *cycles: Iterable[Delivery],
    plan: RunPlan = PLAN,
    scenario: str = SCENARIO,
    driver: str = "launch",
    start: Run | None = None,
    ended: bool = True,
) -> Path:
    """A recording of these cycles, each message logged when it was published.

    The plan has as many cycles unless it states how many.
    """
    anchor = ClockAnchor(0, 1_700_000_000_000_000_000)
    first = replace(plan.run_message("start", 0, START_NS), publish_time_ns=START_NS - 200 * MS)
    run: list[Delivery] = [(RUN.of(ROOT), start or first), *chain(*cycles)]
    logged = [(port, one, max(one.publish_time_ns, START_NS - 200 * MS)) for port, one in run]
    if ended:
        plan = _end(logged, plan)
    path = folder / "run.mcap"
    write_messages(path, logged, plan=plan, scenario=scenario, driver=driver, anchor=anchor)
    return folder


def recorded_at(
    folder: Path, run: Iterable[tuple[Port[Message], Message, int]], plan: RunPlan
) -> Path:
    """A recording of messages that arrived at the recorder at stated times [ns]."""
    start = replace(plan.run_message("start", 0, START_NS), publish_time_ns=START_NS - 200 * MS)
    logged = [(RUN.of(ROOT), start, START_NS - 200 * MS), *sorted(run, key=lambda one: one[2])]
    plan = _end(logged, plan)
    anchor = ClockAnchor(0, 1_700_000_000_000_000_000)
    path = folder / "run.mcap"
    write_messages(path, logged, plan=plan, scenario=SCENARIO, driver="launch", anchor=anchor)
    return folder


def _end(logged: list[tuple[Port[Message], Message, int]], plan: RunPlan) -> RunPlan:
    """Add the message that ends the run; return the plan with the cycles that it has."""
    last, at_ns = max(one[1].cycle for one in logged), max(one[2] for one in logged)
    if plan.timing.cycles == PLAN.timing.cycles:
        plan = with_changes(plan, cycles=last + 1)
    stop = replace(plan.run_message("stop", last + 1, START_NS), publish_time_ns=at_ns)
    logged.append((RUN.of(ROOT), stop, at_ns))
    return plan
