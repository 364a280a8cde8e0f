"""What a recording holds: counts, losses and states of agents."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TypeAlias

import msgspec

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import PRODUCTION, SIGNALS, Port, Signal
from bus_schemas.tree import RECORDER, ROOT
from recordings.inspect.agent_states import AgentSpan, AgentStates
from recordings.read.gaps import PortGaps
from recordings.read.reader import RunReader
from recordings.read.run_file import RECOVERY_METADATA
from recordings.read.series import Listener

Gaps: TypeAlias = dict[Port[Message], PortGaps]


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


class Misses(msgspec.Struct, frozen=True):
    """Inputs that an agent missed at its deadlines, and older messages that it used."""

    agent: str
    inputs: int
    old: int
    first_cycle: int
    last_cycle: int
    external: bool


class Overview(msgspec.Struct, frozen=True, kw_only=True):
    """What a recording holds, and how the run fared.

    `lost` counts messages that the sequence numbers leave out, by port, most first. `misses` are by
    agent, most first. The run ended before the `stop_cycle`; None: that is not recorded. `states`:
    when agents were absent, cut off or given up.
    """

    path: str
    run_id: str
    metadata: dict[str, dict[str, str]]
    whole: bool
    last_cycle: int
    complete_cycles: int
    planned_cycles: int
    wall_s: float
    signals: tuple[SignalCount, ...]
    lost: dict[str, int] = {}
    misses: tuple[Misses, ...] = ()
    states: tuple[AgentSpan, ...] = ()
    files: int = 1
    stop_cycle: int | None

    @property
    def messages_lost(self) -> int:
        return sum(self.lost.values())

    @property
    def repeated(self) -> int:
        return sum(one.repeated for one in self.signals)

    @property
    def missing_inputs(self) -> int:
        """Number of inputs that agents missed at their deadlines, without external agents."""
        return sum(misses.inputs for misses in self.misses if not misses.external)

    @property
    def old_inputs(self) -> int:
        """Number of older messages that they used instead."""
        return sum(misses.old for misses in self.misses if not misses.external)

    @property
    def unrecorded(self) -> list[AgentSpan]:
        return sorted(
            (span for span in self.states if span.is_unrecorded_plant),
            key=lambda span: span.first_cycle,
        )


def read_overview(run: RunReader) -> Overview:
    return read_through(run)[0]


def read_through(
    run: RunReader, listener: Listener | None = None, run_cycles: int = 0
) -> tuple[Overview, Gaps]:
    """Go through a recording once; return what it holds, and the messages of each port.

    run_cycles: How many cycles the run had, if that is known from elsewhere.
    """
    plan = run.plan
    states = AgentStates(plan)
    heard = listener.ports if listener else ()
    first_ns = last_ns = 0
    for record in run.records():
        states.see(record)
        last_ns = record.log_time_ns
        first_ns = first_ns or last_ns
        if listener and record.port in heard and (message := run.decoded(record)):
            listener.see(record.port, message)
    # If the run's end was not recorded, the cycles up to the last production were due.
    end = states.end_cycle(run.stop_cycle)
    cycles = max(run.last_cycle + 1, run.stop_cycle or 0)
    if run.outline.closed:
        states.finish(end)
    gaps, wall_s = states.gaps, (last_ns - first_ns) / 1e9
    sent = {port.signal for port in gaps}
    spans = sorted(
        _spans(states, end, run_cycles if run.outline.closed else 0),
        key=lambda one: one.weight,
        reverse=True,
    )
    lost = Counter({str(port): one.lost for port, one in gaps.items() if one.lost})
    overview = Overview(
        path=str(run.path),
        run_id=plan.run_id,
        metadata=run.metadata,
        whole=run.whole,
        files=len(run.files),
        last_cycle=cycles - 1,
        complete_cycles=gaps[PRODUCTION.of(ROOT)].cycles(plan.timing.cycles),
        planned_cycles=plan.timing.cycles,
        wall_s=wall_s,
        signals=tuple(
            _count(signal, gaps, cycles, end, wall_s) for signal in SIGNALS if signal in sent
        ),
        lost=dict(lost.most_common()),
        misses=_misses(plan, states),
        states=tuple(spans),
        stop_cycle=run.stop_cycle,
    )
    return overview, gaps


def _spans(states: AgentStates, end: int, run_cycles: int) -> Iterator[AgentSpan]:
    yield from states.spans()
    if run_cycles > end:  # Who hears nothing to the end does not know of it.
        yield AgentSpan(RECORDER, "cut off", end, run_cycles - end)


def _misses(plan: RunPlan, states: AgentStates) -> tuple[Misses, ...]:
    missed, external = states.missed, plan.access.external
    misses = [
        Misses(agent, missed.missing[agent].total(), missed.old[agent], *at, agent in external)
        for agent, at in missed.cycles.items()
    ]
    return tuple(sorted(misses, key=lambda one: (-one.inputs, one.agent)))


def _count(
    signal: Signal[Message],
    gaps: Gaps,
    cycles: int,
    end: int,
    wall_s: float,
) -> SignalCount:
    """Return the count of a signal in a run; messages were due in the cycles before `end`."""
    own = [one for port, one in gaps.items() if port.signal is signal]
    messages = sum(one.messages for one in own)
    return SignalCount(
        signal=signal.name,
        nodes=sum(1 for one in own if one.messages),
        messages=messages,
        per_cycle=messages / cycles if cycles else 0.0,
        per_s=messages / wall_s if wall_s else 0.0,
        lost=sum(one.lost for one in own),
        repeated=sum(one.repeated for one in own),
        missing_cycles=sum(max(one.missing(end), 0) for one in own),
    )


def facts(run: RunReader, overview: Overview) -> Iterator[tuple[str, str]]:
    plan, origin = run.plan, overview.metadata["run"]
    size_mb = sum(stat.st_size for stat in run.stats()) / 1e6
    size = f"{size_mb:,.1f} MB, files: {len(run.files)}, chunks: {len(run.outline.chunks):,}"
    yield "recording", f"{overview.path} ({size})"
    timing = plan.timing
    pace = "lockstep" if timing.lockstep else f"pace {timing.cycle_ns / timing.cycle_wall_ns:g}"
    scheme = f"scheme {plan.control.scheme}, actuator {plan.control.actuator}"
    yield "run", f"heliarch {origin.get('driver')}, plant {plan.plant}, {scheme}, {pace}"
    last = max(overview.last_cycle, 0)
    shown = f"0 to {last:,}" if overview.last_cycle >= 0 else "none"
    begin, end = (f"{run.clock.local(cycle):%F %T}" for cycle in (0, last))
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
