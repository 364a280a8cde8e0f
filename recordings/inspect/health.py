"""How a run fared: faults, lost and dropped messages, missed inputs, agents that left or died.

Most of it follows from the recording itself. What only the launcher and the agents know is in
`summary.json` and `failure.txt` beside it; without those files it is "not recorded".
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, TypeVar

import msgspec

from agents.plan import RunPlan
from bus_schemas.faults import UNHEARD, FaultRule
from bus_schemas.messages import Message
from bus_schemas.network_faults import FaultAct, FaultTally, NetworkFaults
from bus_schemas.signals import TELEMETRY, Port
from bus_schemas.tree import RECORDER, some_of
from recordings.read.gaps import LISTED_GAPS, RunGaps, due_step
from recordings.read.missed_inputs import MissedInputs
from recordings.read.reader import RecordedMessage, RunReader
from recordings.read.run_clock import RunClock
from sunspec.process import DeviceAccount, read_accounts

SUMMARY_NAME: Final = "summary.json"
FAILURE_NAME: Final = "failure.txt"
_NAMED: Final = 5
"""So many of each kind are named in the text, the rest is counted."""


class Absence(msgspec.Struct, frozen=True):
    """An agent of which nothing came in some cycles; in 0 of them if it only restarted.

    It was heard again, or its other process joined, in the cycle `back_in`; None: it was not. If
    it restarted it then was of another process, maybe its standby. A real inverter is named
    `device c2/inv07`: it has no telemetry while it is gone.
    """

    agent: str
    first_cycle: int
    cycles: int
    back_in: int | None
    restarted: bool
    by_standby: bool = False

    @property
    def weight(self) -> tuple[bool, int]:
        """What it is sorted by: the agent did not come back as it was, or for how long."""
        return self.restarted or self.back_in is None, self.cycles


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
    """The part of a run's health that only the launcher knows, from the run's summary.

    `dropped`: messages that agents could not use, by cause. `skipped_cycles` were over before a
    process came to them. `recording_ended`: why the recording stops before the run's end.
    """

    run_id: str
    dropped: dict[str, int] = {}
    restarts: dict[str, int] = {}
    skipped_cycles: int = 0
    recording_ended: str = ""
    wrong: tuple[WrongMessages, ...] = ()


Account = TypeVar("Account", bound=LauncherAccount)


class Health(msgspec.Struct, frozen=True):
    """How a run fared.

    `faults` counts what all rules did to messages, by kind. `lost` counts messages that the
    sequence numbers leave out, by port, most first. `misses` are by agent, most first. `ended`: the
    recording goes up to the run's end. `failure`: why the launcher gave up. `launcher` is None
    without a summary beside the recording.
    """

    fault_acts: tuple[FaultAct, ...]
    faults: dict[str, int]
    lost: dict[str, int]
    repeated: int
    misses: tuple[Misses, ...]
    absences: tuple[Absence, ...]
    ended: bool
    failure: str
    launcher: LauncherAccount | None
    more_absences: int = 0
    devices: tuple[DeviceAccount, ...] = ()

    @property
    def messages_lost(self) -> int:
        return sum(self.lost.values())

    @property
    def missing_inputs(self) -> int:
        """Number of inputs that agents missed at their deadlines, without external agents."""
        return sum(found.inputs for found in self.misses if not found.external)

    @property
    def old_inputs(self) -> int:
        """Number of older messages that they used instead."""
        return sum(found.old for found in self.misses if not found.external)


class HealthWatch:
    """Follows a recording message by message."""

    def __init__(self, plan: RunPlan, cycles: range) -> None:
        self.gaps = RunGaps(plan, cycles.start)
        self._plan = plan
        # What became of a message follows from its link and cycle: it is worked out once more here.
        self._faults = NetworkFaults(plan.faults, plan.faults_seed, plan.tree, plan.cycle_ns)
        self._tally = FaultTally()
        # The agents that publish in every turn, and after how many cycles.
        steps: dict[str, int] = {}
        for port in self.gaps.ports:
            if step := due_step(plan, port):
                steps[port.publisher] = min(step, steps.get(port.publisher, step))
        self._devices: dict[Port[Message], str] = {
            TELEMETRY.of(node): f"device {node}" for node, _ in plan.devices
        }
        steps |= dict.fromkeys(self._devices.values(), 1)
        self._step = steps
        self._last_cycle = dict.fromkeys(steps, cycles.start - 1)
        # The cycle in which the process that speaks for each agent joined.
        self._joined = dict.fromkeys(steps, max(cycles.start - 1, 0))
        self._absences: list[Absence] = []
        self._more_absences = 0
        self._missed = MissedInputs(plan)

    def see(self, record: RecordedMessage) -> None:
        port, cycle = record.port, record.cycle
        found = self.gaps.ports[port]
        lost = found.lost
        self.gaps.see(port, cycle, record.sequence, record.incarnation)
        agent, joined = port.publisher, None
        if agent in self._last_cycle:
            if found.lost > lost:  # It was there: its messages are not.
                self._last_cycle[agent] = max(self._last_cycle[agent], cycle - 1)
            if record.incarnation > self._joined[agent]:
                joined = self._joined[agent] = record.incarnation
            self._see_agent(agent, cycle, joined)
        if port in self._devices:
            self._see_agent(self._devices[port], cycle, None)
        if self._plan.faults and port.signal.is_cyclic:
            self._see_faults(port, record.message())
        self._missed.see(record)

    def health(self, run: RunReader, cycle: int) -> Health:
        """Return the health of the run, which ended before `cycle`, with what its folder tells."""
        self.gaps.end(cycle)
        for agent, last in self._last_cycle.items():
            # A run that broke off has not completed its last cycle.
            if cycle > last + self._step[agent] + 1:
                self._note(Absence(agent, last + 1, cycle - last - 1, None, False))
        ports, missed, external = self.gaps.ports, self._missed, self._plan.external
        misses = [
            Misses(agent, missed.missing[agent].total(), missed.old[agent], *at, agent in external)
            for agent, at in missed.cycles.items()
        ]
        lost = Counter({str(port): found.lost for port, found in ports.items() if found.lost})
        return Health(
            fault_acts=tuple(
                self._stop_act(act.rule, run) if act.rule.stops else act
                for act in self._faults.acts
            ),
            faults=dict(+self._tally),
            lost=dict(lost.most_common()),
            repeated=sum(found.repeated for found in ports.values()),
            misses=tuple(sorted(misses, key=lambda one: one.inputs, reverse=True)),
            absences=tuple(self._absences),
            ended=run.stop_cycle is not None,
            failure=_failure(run.path.parent),
            launcher=summary_in(run.path.parent, run.plan, LauncherAccount),
            more_absences=self._more_absences,
            devices=read_accounts(run.path.parent),
        )

    def _stop_act(self, rule: FaultRule, run: RunReader) -> FaultAct:
        """Return in which cycle a rule killed or froze controllers, if the run came to that."""
        cycle = int(rule.at[0] * 1e9 / self._plan.cycle_ns)
        return FaultAct(rule) if cycle > run.last_cycle else FaultAct(rule, 0, cycle, cycle)

    def _see_faults(self, port: Port[Message], message: Message) -> None:
        """Work out what became of a message on the way to each listener whose end is ours."""
        for listener in self._plan.wiring.listeners[port]:
            if listener not in self._plan.external:
                self._tally.count(self._faults.fates(port, listener, message))

    def _see_agent(self, agent: str, cycle: int, joined: int | None) -> None:
        """Note that an agent was absent, or that a new process of it joined."""
        last = self._last_cycle[agent]
        self._last_cycle[agent] = max(cycle, last)
        # A process that was started again stands by where there is a standby.
        by_standby = joined is not None and agent in self._plan.standbys
        if cycle > last + self._step[agent]:
            gone, is_new = cycle - last - 1, joined is not None
            self._note(Absence(agent, last + 1, gone, cycle, is_new, by_standby))
        elif joined is not None:
            self._note(Absence(agent, joined, 0, joined, True, by_standby))

    def _note(self, absence: Absence) -> None:
        """Keep an absence; beyond `LISTED_GAPS` the shortest are only counted."""
        self._absences.append(absence)
        if len(self._absences) > LISTED_GAPS:
            self._absences.remove(min(self._absences, key=lambda one: one.weight))
            self._more_absences += 1


def health_lines(health: Health, clock: RunClock) -> Iterator[tuple[str, str]]:
    """Yield the health of a run as text: what is looked at, and what was found."""
    launcher = health.launcher
    touched = f"messages: {counts_text(health.faults) or 'none touched'}"
    yield "faults", touched if health.fault_acts else "none injected"
    for act in health.fault_acts:
        yield "fault", f"{act.rule}: {_act_text(act, clock)}"
    yield "missing", f"{health.messages_lost:,} messages not recorded{_named(health.lost)}"
    if health.repeated:
        yield "repeated", f"{health.repeated:,} messages came again"
    yield "dropped", _dropped(launcher)
    yield "inputs", _missed_text(health, clock)
    by_weight = sorted(health.absences, key=lambda one: one.weight, reverse=True)
    for absence in by_weight[:_NAMED]:
        yield "absent", _absence_text(absence, clock)
    if others := len(by_weight[_NAMED:]) + health.more_absences:
        yield "absent", f"and {others:,} times more"
    # Messages show which agents restarted; the recorder publishes none.
    if recorder := launcher.restarts.get(RECORDER) if launcher else None:
        yield "absent", f"{RECORDER}: restarted ({recorder:,})"
    elif not by_weight:
        yield "absent", "none"
    yield from (("devices", text) for text in _devices_texts(health.devices))
    end = "ended in order" if health.ended else "the recording stops before the run's end"
    if health.failure:
        end = f"failed: {health.failure}"
    yield "run", launcher.recording_ended if launcher and launcher.recording_ended else end


def _act_text(act: FaultAct, clock: RunClock) -> str:
    if act.rule.signal in UNHEARD:
        return f"changed nothing: no agent acts on {act.rule.signal}"
    if act.first_cycle is None or act.last_cycle is None:
        return "never acted"
    on = "" if act.rule.stops else f"on {act.messages:,} messages "
    return f"acted {on}{clock.span_text(act.first_cycle, act.last_cycle)}"


def _dropped(launcher: LauncherAccount | None) -> str:
    if launcher is None:
        return f"not recorded: there is no {SUMMARY_NAME} beside the recording"
    dropped, skipped = launcher.dropped, launcher.skipped_cycles
    wrong = [f"{w.count:,} {w.cause} on {w.key}" for w in launcher.wrong]
    parts = [f"{sum(dropped.values()):,} messages that agents could not use{_named(dropped)}"]
    parts += [f"{skipped:,} cycles skipped"] if skipped else []
    parts += [f"wrong: {some_of(wrong, _NAMED)}"] if wrong else []
    return "; ".join(parts)


def counts_text(counts: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {name}" for name, count in counts.items())


def _named(counts: Mapping[str, int]) -> str:
    """List the first counts with their names, after a colon; empty if there are none."""
    listed = some_of([f"{name} {count:,}" for name, count in counts.items()], _NAMED)
    return f": {listed}" if listed else ""


def _missed_text(health: Health, clock: RunClock) -> str:
    misses = health.misses
    if not misses:
        return "none missed at a deadline"
    first = min(found.first_cycle for found in misses)
    last = max(found.last_cycle for found in misses)
    worst = _named({found.agent: found.inputs for found in misses})
    used = f"{health.missing_inputs:,} missed and {health.old_inputs:,} older ones used"
    return f"{used} {clock.span_text(first, last)}, most at{worst}"


def _absence_text(absence: Absence, clock: RunClock) -> str:
    first, cycles = absence.first_cycle, absence.cycles
    gone = f"nothing {clock.span_text(first, first + cycles - 1)}, " if cycles else ""
    if absence.back_in is None:
        return f"{absence.agent}: {gone}not back"
    how = "its standby took over" if absence.by_standby else "restarted"
    how = how if absence.restarted else "back"
    return f"{absence.agent}: {gone}{how} in cycle {absence.back_in:,}"


def _devices_texts(devices: tuple[DeviceAccount, ...]) -> Iterator[str]:
    fields = {"breaks": "lost connections", "late": "late readings", "refused": "refused requests"}
    for field, what in fields.items():
        if counts := +Counter({device.node: getattr(device, field) for device in devices}):
            yield f"{counts.total():,} {what}, most at{_named(dict(counts.most_common()))}"


def summary_in(folder: Path, plan: RunPlan, kind: type[Account]) -> Account | None:
    """Return the summary in a folder, or a part of it; None if there is none of this run."""
    try:
        found = msgspec.json.decode((folder / SUMMARY_NAME).read_bytes(), type=kind)
    except (OSError, msgspec.DecodeError):
        return None
    return found if found.run_id == plan.run_id else None


def _failure(folder: Path) -> str:
    try:
        return " ".join((folder / FAILURE_NAME).read_text(encoding="utf-8").split())
    except (OSError, UnicodeDecodeError):
        return ""
