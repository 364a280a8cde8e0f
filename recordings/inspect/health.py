"""How a run fared: faults, lost and dropped messages, missed inputs, agents that left or died.

Most of it follows from the recording itself. What only the launcher and the agents know is in
`summary.json` and `failure.txt` beside it; without those files it is "not recorded".
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeVar

import msgspec
from msgspec.structs import replace

from agents.faults import Fault, Kill, ProcessFault
from agents.plan import RunPlan
from bus_schemas.errors import InputError, listed
from bus_schemas.faults import UNHEARD, Blackout, Disturbance
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import RECORDER
from recordings.inspect.agent_states import AgentSpan, AgentStates
from recordings.read.reader import RecordedMessage, RunReader
from recordings.read.run_clock import RunClock
from scenarios.fault_rules import fault_text

SUMMARY_NAME: Final = "summary.json"
FAILURE_NAME: Final = "failure.txt"
_NAMED: Final = 5
"""How many of each kind the text names; the others are counted."""

_MOST_STATES: Final = 100


class FaultEffect(msgspec.Struct, frozen=True):
    """How many messages a fault acted on, once for each listener, and in which cycles."""

    fault: Fault
    messages: int = 0
    first_cycle: int | None = None
    last_cycle: int | None = None


class Misses(msgspec.Struct, frozen=True):
    """Inputs that an agent missed at its deadlines, and older messages that it used."""

    agent: str
    inputs: int
    old: int
    first_cycle: int
    last_cycle: int
    external: bool


class WrongMessages(msgspec.Struct, frozen=True):
    """Messages of one key that were wrong in one way, with an explanation of the first one.

    `publisher` is the agent that may publish on the key; empty: the run has no such key.
    """

    key: str
    cause: str
    count: int
    example: str
    publisher: str = ""


class LauncherAccount(msgspec.Struct, frozen=True, kw_only=True):
    """The part of a run's health that only the launcher knows.

    `dropped`: messages that agents could not use, by cause. `skipped_cycles` were over before a
    process came to them. `recording_ended`: why the recording does not hold the run as a whole.
    `given_up`: processes that were not started again, and since which cycle. `recording_gaps`:
    first and last cycles that the recorder did not hear.
    """

    dropped: dict[str, int] = {}
    restarts: dict[str, int] = {}
    skipped_cycles: int = 0
    recording_ended: str = ""
    given_up: dict[str, int] = {}
    recording_gaps: tuple[tuple[int, int], ...] = ()
    wrong: tuple[WrongMessages, ...] = ()
    interrupted: bool = False


class RunDocument(msgspec.Struct, frozen=True, kw_only=True):
    """What the health of a run takes from its summary."""

    run_id: str
    launcher: LauncherAccount


Document = TypeVar("Document", bound=RunDocument)


class Health(msgspec.Struct, frozen=True, kw_only=True):
    """How a run fared.

    `faults` counts what all rules did to messages, by kind. `lost` counts messages that the
    sequence numbers leave out, by port, most first. `misses` are by agent, most first. The run
    ended before the `stop_cycle`; None: that is not recorded. `states`: when agents were absent,
    cut off or given up. `failure`: why the launcher gave up. `launcher` is None
    without a summary beside the recording.
    """

    fault_effects: tuple[FaultEffect, ...] = ()
    faults: dict[str, int] = {}
    lost: dict[str, int] = {}
    repeated: int = 0
    misses: tuple[Misses, ...] = ()
    states: tuple[AgentSpan, ...] = ()
    more_states: int = 0
    stop_cycle: int | None
    failure: str = ""
    launcher: LauncherAccount | None

    @property
    def messages_lost(self) -> int:
        return sum(self.lost.values())

    @property
    def missing_inputs(self) -> int:
        """Number of inputs that agents missed at their deadlines, without external agents."""
        return sum(misses.inputs for misses in self.misses if not misses.external)

    @property
    def old_inputs(self) -> int:
        """Number of older messages that they used instead."""
        return sum(misses.old for misses in self.misses if not misses.external)


class HealthWatch:
    """Follows a recording message by message."""

    def __init__(self, plan: RunPlan, cycles: range) -> None:
        self.states = AgentStates(plan, cycles.start)
        self._plan = plan
        # The fate of a message follows from its link and cycle, so it can be worked out again here.
        self._faults = plan.network_faults()

    def see(self, record: RecordedMessage) -> None:
        self.states.see(record)
        if self._plan.faults.rules and record.port.signal.is_cyclic:
            with suppress(InputError):  # The reader names a wrong message.
                self._see_faults(record.port, record.message())

    def health(self, run: RunReader, cycle: int) -> Health:
        """Return the health up to a cycle, without it."""
        ports, missed, external = self.states.gaps, self.states.missed, self._plan.access.external
        if run.outline.closed:
            self.states.finish(cycle)
        misses = [
            Misses(agent, missed.missing[agent].total(), missed.old[agent], *at, agent in external)
            for agent, at in missed.cycles.items()
        ]
        states = sorted(self.states.spans(), key=lambda one: one.weight, reverse=True)
        lost = Counter({str(port): gaps.lost for port, gaps in ports.items() if gaps.lost})
        health = Health(
            fault_effects=tuple(self._effects(run.last_cycle)),
            faults=dict(+self._faults.tally),
            lost=dict(lost.most_common()),
            repeated=sum(gaps.repeated for gaps in ports.values()),
            misses=tuple(sorted(misses, key=lambda one: (-one.inputs, one.agent))),
            states=tuple(states[:_MOST_STATES]),
            stop_cycle=run.stop_cycle,
            launcher=None,
            more_states=len(states[_MOST_STATES:]),
        )
        return with_account(health, run)

    def _effects(self, last_cycle: int) -> Iterator[FaultEffect]:
        for number, fault in enumerate(self._plan.faults.rules):
            if isinstance(fault, ProcessFault):
                begin_s = fault.at if isinstance(fault, Kill) else fault.at[0]
                cycle = int(begin_s * 1e9 / self._plan.timing.cycle_ns)
                came = cycle <= last_cycle
                yield FaultEffect(fault, 0, cycle, cycle) if came else FaultEffect(fault)
            else:
                act = self._faults.acts[number]
                yield FaultEffect(fault, act.messages, act.first_cycle, act.last_cycle)

    def _see_faults(self, port: Port[Message], message: Message) -> None:
        """Work out the fate of a message on its way to each listener that is not external."""
        for listener in self._plan.wiring.listeners[port]:
            if listener not in self._plan.access.external:
                self._faults.fates(port, listener, message)


def with_account(health: Health, run: RunReader) -> Health:
    """Return the health of a run with what the launcher has written into its folder."""
    document = summary_in(run.path.parent, run.plan, RunDocument)
    launcher = document.launcher if document else None
    return replace(health, failure=failure_in(run.path.parent), launcher=launcher)


def health_lines(health: Health, clock: RunClock) -> Iterator[tuple[str, str]]:
    launcher = health.launcher
    touched = f"messages: {counts_text(health.faults) or 'none touched'}"
    yield "faults", touched if health.fault_effects else "none injected"
    for effect in health.fault_effects:
        yield "fault", f"{fault_text(effect.fault)}: {_effect_text(effect, clock)}"
    yield "missing", f"{health.messages_lost:,} messages not recorded{_named(health.lost)}"
    if health.repeated:
        yield "repeated", f"{health.repeated:,} messages came again"
    yield "dropped", _dropped(launcher)
    yield "inputs", _missed_text(health, clock)
    for span in health.states[:_NAMED]:
        yield "states", span.text(clock)
    if others := len(health.states[_NAMED:]) + health.more_states:
        yield "states", f"and {others:,} more"
    # Messages show which agents restarted; the recorder publishes none.
    if recorder := launcher.restarts.get(RECORDER) if launcher else None:
        yield "states", f"{RECORDER}: restarted ({recorder:,})"
    elif not health.states:
        yield "states", "no agent was absent, cut off or given up"
    yield from _lacks(launcher, clock) if launcher else ()
    end, planned = "ended in order", clock.plan.timing.cycles
    if health.failure:
        end = f"failed: {health.failure}"
    elif health.stop_cycle is None:
        end = "the recording stops before the run's end"
    elif health.stop_cycle < planned:
        end = f"interrupted after {health.stop_cycle:,} of {planned:,} cycles"
    yield "run", launcher.recording_ended if launcher and launcher.recording_ended else end


def _lacks(launcher: LauncherAccount, clock: RunClock) -> Iterator[tuple[str, str]]:
    for name, cycle in launcher.given_up.items():
        yield "given up", f"{name} {clock.span_text(cycle, cycle)}"
    for first, last in launcher.recording_gaps:
        yield "gap", f"not recorded {clock.span_text(first, last)}: the recorder was cut off"


def _effect_text(effect: FaultEffect, clock: RunClock) -> str:
    fault = effect.fault
    if isinstance(fault, Disturbance | Blackout) and fault.signal in UNHEARD:
        return f"changed nothing: no agent acts on {fault.signal}"
    if effect.first_cycle is None or effect.last_cycle is None:
        return "never acted"
    on = "" if isinstance(fault, ProcessFault) else f"on {effect.messages:,} messages "
    return f"acted {on}{clock.span_text(effect.first_cycle, effect.last_cycle)}"


def _dropped(launcher: LauncherAccount | None) -> str:
    if launcher is None:
        return f"not recorded: there is no {SUMMARY_NAME} beside the recording"
    dropped, skipped = launcher.dropped, launcher.skipped_cycles
    wrong = [f"{w.count:,} {w.cause} on {w.key}" for w in launcher.wrong]
    parts = [f"{sum(dropped.values()):,} messages that agents could not use{_named(dropped)}"]
    parts += [f"{skipped:,} cycles skipped"] if skipped else []
    parts += [f"wrong: {listed(wrong, _NAMED)}"] if wrong else []
    return "; ".join(parts)


def counts_text(counts: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {name}" for name, count in counts.items())


def _named(counts: Mapping[str, int]) -> str:
    """List the first counts with their names, after a colon; empty if there are none."""
    named = listed([f"{name} {count:,}" for name, count in counts.items()], _NAMED)
    return f": {named}" if named else ""


def _missed_text(health: Health, clock: RunClock) -> str:
    misses = health.misses
    if not misses:
        return "none missed at a deadline"
    first = min(one.first_cycle for one in misses)
    last = max(one.last_cycle for one in misses)
    worst = _named({one.agent: one.inputs for one in misses})
    used = f"{health.missing_inputs:,} missed and {health.old_inputs:,} older ones used"
    return f"{used} {clock.span_text(first, last)}, most at{worst}"


def summary_in(folder: Path, plan: RunPlan, kind: type[Document]) -> Document | None:
    """Return the summary in a folder, or a part of it; None if there is none of this run."""
    try:
        summary = msgspec.json.decode((folder / SUMMARY_NAME).read_bytes(), type=kind)
    except (OSError, msgspec.DecodeError):
        return None
    return summary if summary.run_id == plan.run_id else None


def failure_in(folder: Path) -> str:
    """Return in a line why the run in a folder failed; empty: it did not."""
    try:
        text = (folder / FAILURE_NAME).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return " ".join(text.split())
