"""What a recording holds: messages and rates of each signal, what is missing, and its health."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec
from msgspec.structs import replace

from bus_schemas.messages import Message
from bus_schemas.signals import PRODUCTION, SIGNALS, Port, Signal
from bus_schemas.tree import ROOT
from bus_schemas.whole_file import whole_file
from recordings.inspect.health import Health, HealthWatch, with_account
from recordings.read.counting import RecordingCount
from recordings.read.gaps import PortGaps
from recordings.read.reader import RunReader
from recordings.read.run_file import RECOVERY_METADATA

OVERVIEW_NAME: Final = "overview.json"


class SignalCount(msgspec.Struct, frozen=True):
    """Messages of one signal.

    `lost` ones were published and not recorded, `repeated` ones came again; in `missing_cycles`,
    summed over nodes, the message that was due is missing.
    """

    signal: str
    nodes: int
    messages: int
    per_cycle: float
    per_s: float
    lost: int
    repeated: int
    missing_cycles: int


class Overview(msgspec.Struct, frozen=True):
    """What a recording holds."""

    path: str
    run_id: str
    metadata: dict[str, dict[str, str]]
    whole: bool
    first_cycle: int
    last_cycle: int
    complete_cycles: int
    planned_cycles: int
    interrupted: bool
    wall_s: float
    signals: tuple[SignalCount, ...]
    health: Health


def keep_overview(recording: Path, count: RecordingCount | None = None) -> Overview:
    """Make the overview of a run that has ended, and keep it beside the recording.

    count: Of a run in which nothing can be late or missing: it says all that there is to say.
    """
    with RunReader(recording) as run:
        overview = _overview(run, None, count)
    with whole_file(recording.parent / OVERVIEW_NAME) as file:
        file.write(msgspec.json.encode(overview))
    return overview


def read_overview(run: RunReader, cycles: range | None = None) -> Overview:
    """Return what a recording holds: as kept at the end of the run, or else by reading it."""
    path = run.path.with_name(OVERVIEW_NAME)
    changed_ns = max(os.fstat(file.fileno()).st_mtime_ns for file in run.files)
    with suppress(OSError, msgspec.DecodeError):
        if cycles is None and path.stat().st_mtime_ns >= changed_ns:
            kept = msgspec.json.decode(path.read_bytes(), type=Overview)
            if kept.run_id == run.plan.run_id:
                return replace(kept, path=str(run.path), health=with_account(kept.health, run))
    return _overview(run, cycles)


def _overview(
    run: RunReader, cycles: range | None, count: RecordingCount | None = None
) -> Overview:
    wanted = range(max(run.last_cycle + 1, run.stop_cycle or 0)) if cycles is None else cycles
    end = 0  # Nothing can be missing.
    if count is None:
        count, health, end = _go_through(run, cycles, wanted)
    else:
        health = with_account(Health(stop_cycle=run.stop_cycle, launcher=None), run)
    wall_s, sent = count.wall_ns / 1e9, {port.signal for port in count.gaps}
    return Overview(
        path=str(run.path),
        run_id=run.plan.run_id,
        metadata=run.metadata,
        whole=run.whole,
        first_cycle=wanted.start,
        last_cycle=wanted.stop - 1,
        complete_cycles=count.gaps[PRODUCTION.of(ROOT)].cycles(run.plan.timing.cycles),
        planned_cycles=run.plan.timing.cycles,
        interrupted=(run.stop_cycle or run.plan.timing.cycles) < run.plan.timing.cycles,
        wall_s=wall_s,
        signals=tuple(
            _count(signal, count.gaps, wanted, end, wall_s) for signal in SIGNALS if signal in sent
        ),
        health=health,
    )


def _go_through(
    run: RunReader, cycles: range | None, wanted: range
) -> tuple[RecordingCount, Health, int]:
    """Go through a recording message by message, most of them without decoding them.

    Also return before which cycle the run or the part ends.
    """
    watch = HealthWatch(run.plan, wanted)
    first_ns = last_ns = 0
    for record in run.records(cycles=cycles):
        watch.see(record)
        last_ns = record.log_time_ns
        first_ns = first_ns or last_ns
    # If the run's end was not recorded, the cycles up to the last production were due.
    end = min(watch.states.end_cycle(run.stop_cycle), wanted.stop)
    return RecordingCount(watch.states.gaps, last_ns - first_ns), watch.health(run, end), end


def _count(
    signal: Signal[Message],
    gaps: dict[Port[Message], PortGaps],
    cycles: range,
    end: int,
    wall_s: float,
) -> SignalCount:
    """Return the count of a signal in some cycles; messages were due in those before `end`."""
    own = [one for port, one in gaps.items() if port.signal is signal]
    messages = sum(one.messages for one in own)
    return SignalCount(
        signal=signal.name,
        nodes=sum(1 for one in own if one.messages),
        messages=messages,
        per_cycle=messages / len(cycles) if cycles else 0.0,
        per_s=messages / wall_s if wall_s else 0.0,
        lost=sum(one.lost for one in own),
        repeated=sum(one.repeated for one in own),
        missing_cycles=sum(max(one.missing(end), 0) for one in own),
    )


def facts(run: RunReader, overview: Overview) -> Iterator[tuple[str, str]]:
    plan, origin = run.plan, overview.metadata["run"]
    size_mb = sum(os.fstat(file.fileno()).st_size for file in run.files) / 1e6
    size = f"{size_mb:,.1f} MB, files: {len(run.files)}, chunks: {len(run.outline.chunks):,}"
    yield "recording", f"{overview.path} ({size})"
    timing = plan.timing
    pace = "lockstep" if timing.lockstep else f"pace {timing.cycle_ns / timing.cycle_wall_ns:g}"
    scheme = f"scheme {plan.control.scheme}, actuator {plan.control.actuator}"
    yield "run", f"heliarch {origin.get('driver')}, plant {plan.plant}, {scheme}, {pace}"
    first, last = overview.first_cycle, max(overview.last_cycle, overview.first_cycle)
    shown = f"{first:,} to {last:,}" if overview.last_cycle >= first else "none"
    begin, end = (f"{run.clock.local(cycle):%F %T}" for cycle in (first, last))
    yield "time", f"{begin} to {end}, {plan.timing.timezone}, recorded in {overview.wall_s:,.1f} s"
    yield (
        "cycles",
        f"{shown} of {plan.timing.cycle_ns / 1e9:g} s, "
        f"{overview.complete_cycles:,} complete, {overview.planned_cycles:,} planned"
        + ", interrupted"
        * overview.interrupted,
    )
    versions = [
        f"{name.removeprefix('version ')} {text}"
        for name, text in origin.items()
        if name.startswith("version ")
    ]
    yield "versions", ", ".join([*versions, f"Python {origin.get('python')}"])
    if "host" in origin:  # A run in memory does not depend on it.
        cpus, kernel = origin.get("cpu_count"), origin.get("kernel")
        yield "host", f"{origin['host']}, {cpus} CPUs, Linux {kernel}"
    recovery = overview.metadata.get(RECOVERY_METADATA, {})
    recovered = [f"{name.replace('_', ' ')} {text}" for name, text in recovery.items() if text]
    yield "file", ", ".join(["whole" if overview.whole else "cut", *recovered])
