"""What a recording holds: messages and rates of each signal, what is missing, and its health."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple, TypeAlias

import msgspec

from bus_schemas.messages import Message
from bus_schemas.signals import PRODUCTION, SIGNALS, Port, Signal
from bus_schemas.tree import ROOT
from recordings.inspect.health import Health, HealthWatch
from recordings.read.gaps import PortGaps, gaps_of_ports
from recordings.read.reader import RunReader
from recordings.read.run_file import RECOVERY_METADATA
from recordings.read.series import Listener

See: TypeAlias = Callable[[Port[Message], Message], None]


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
    wall_s: float
    signals: tuple[SignalCount, ...]
    health: Health


class Reading(NamedTuple):
    """The result of one pass over a recording: an overview, and the messages of each port."""

    overview: Overview
    gaps: dict[Port[Message], PortGaps]

    def by_signal(self, publisher: str | None = None) -> Counter[str]:
        """Return the messages of each signal, of one publisher or of all."""
        counts: Counter[str] = Counter()
        for port, gaps in self.gaps.items():
            if publisher in {None, port.publisher}:
                counts[port.signal.name] += gaps.messages
        return +counts


def read_overview(run: RunReader, cycles: range | None = None) -> Overview:
    """Read what a recording holds, or a part of it."""
    return read_through(run, cycles).overview


def read_through(
    run: RunReader,
    cycles: range | None = None,
    listener: Listener | None = None,
    *,
    only_count: bool = False,
) -> Reading:
    """Go through a recording once; a listener sees the messages of its ports.

    only_count: Nothing can be late or missing in it: a million messages a second.
    """
    wanted = range(max(run.last_cycle + 1, run.stop_cycle or 0)) if cycles is None else cycles
    ports = listener.ports if listener else frozenset[Port[Message]]()
    see = listener.see if listener else _see_nothing
    if only_count:
        gaps, wall_ns = _counted(run, ports, see)
        health, end = Health(stop_cycle=run.stop_cycle), 0
    else:
        watch = HealthWatch(run.plan, wanted)
        wall_ns = _watched(run, cycles, watch, ports, see)
        # If the run's end was not recorded, the cycles up to the last production were due.
        end = min(watch.states.end_cycle(run.stop_cycle), wanted.stop)
        gaps, health = watch.states.gaps, watch.health(run, end)
    wall_s, sent = wall_ns / 1e9, {port.signal for port in gaps}
    overview = Overview(
        path=str(run.path),
        run_id=run.plan.run_id,
        metadata=run.metadata,
        whole=run.whole,
        first_cycle=wanted.start,
        last_cycle=wanted.stop - 1,
        complete_cycles=gaps[PRODUCTION.of(ROOT)].cycles(run.plan.timing.cycles),
        planned_cycles=run.plan.timing.cycles,
        wall_s=wall_s,
        signals=tuple(
            _count(signal, gaps, wanted, end, wall_s) for signal in SIGNALS if signal in sent
        ),
        health=health,
    )
    return Reading(overview, gaps)


def _see_nothing(port: Port[Message], message: Message) -> None:
    """Stand for the listener where there is none."""


def _watched(
    run: RunReader,
    cycles: range | None,
    watch: HealthWatch,
    ports: Collection[Port[Message]],
    see: See,
) -> int:
    """Let a watch see each message, most of them without decoding them; return the time [ns]."""
    first_ns = last_ns = 0
    for record in run.records(cycles=cycles):
        watch.see(record)
        last_ns = record.log_time_ns
        first_ns = first_ns or last_ns
        if record.port in ports and (message := run.decoded(record)):
            see(record.port, message)
    return last_ns - first_ns


def _counted(
    run: RunReader, ports: Collection[Port[Message]], see: See
) -> tuple[dict[Port[Message], PortGaps], int]:
    """Count messages, most of them without looking into them; return them and the time [ns]."""
    gaps, counts, first_ns, last_ns = gaps_of_ports(run.plan), Counter[int](), 0, 0
    read = {
        number: port
        for number, port in run.channels.items()
        if port in ports or port.signal is PRODUCTION
    }
    for chunk in run.followed_chunks():
        for channel, _, last_ns, _, _ in run.messages_of(chunk, run.channels):
            counts[channel] += 1
            first_ns = first_ns or last_ns
        for record in run.records_of(chunk, read):
            gaps[record.port].see(record.cycle, record.sequence, record.incarnation)
            if record.port in ports and (message := run.decoded(record)):
                see(record.port, message)
    for channel, count in counts.items():
        gaps[run.channels[channel]].messages = count
    return gaps, last_ns - first_ns


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
        f"{overview.complete_cycles:,} complete, {overview.planned_cycles:,} planned",
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
