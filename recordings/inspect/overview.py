"""What a recording holds: messages and rates of each signal, and what is missing in between."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from typing import Final

import msgspec

from bus_schemas.messages import Message
from bus_schemas.signals import PRODUCTION, SIGNALS, Port, Signal
from recordings.read.completeness import due_step
from recordings.read.reader import RecordedMessage, RunReader
from recordings.recover import RECOVERY_METADATA

_LISTED_GAPS: Final = 100
"""So many gaps are kept with their place; the rest is counted."""

_FOLLOW_EVERY: Final = 10_000
"""Messages between two looks at how far the reading has come."""


class Gap(msgspec.Struct, frozen=True):
    """Cycles without the message that was due in them.

    Attributes
    ----------
    port
        Which message, for instance `c1/inv07/impp`.
    first_cycle, last_cycle
        First and last cycle without it.
    cycles
        How many cycles it was due in.
    """

    port: str
    first_cycle: int
    last_cycle: int
    cycles: int


class SignalCount(msgspec.Struct, frozen=True):
    """Messages of one signal.

    Attributes
    ----------
    signal
        Its name.
    nodes
        About how many nodes there are messages.
    messages
        How many there are.
    per_cycle, per_s
        The same for each cycle, and for each second of the wall clock.
    lost
        Messages that were published and are not in the recording: told by sequence numbers.
    repeated
        Messages whose sequence number had come before.
    missing_cycles
        Cycles, summed over nodes, without the message that was due in them.
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
    """What a recording holds.

    Attributes
    ----------
    path
        The MCAP file.
    run_id, plant, title, driver
        Which run it is; the title is the scenario's.
    whole
        Whether the file was closed in order.
    size_mb
        Of the file, and the number of its chunks [MB of 1,000,000 bytes].
    start, end, timezone
        Local time at the beginning of the first and of the last cycle.
    first_cycle, last_cycle, planned_cycles
        The cycles that were counted, and how many the plan of the run has.
    complete_cycles
        Those of which the plant said what came of them.
    cycle_s, simulated_s, wall_s
        Length of a cycle and of all of them; time on the wall clock between the first and the
        last message.
    scheme, actuator, lockstep, pace
        How the run was controlled and timed; pace in simulated seconds per second, 0 in lockstep.
    versions, origin
        Versions of the software, and the rest of what the recording says of where it is from.
    recovery
        What `heliarch recover` wrote into a file that it made; empty otherwise.
    signals
        What there is of each signal.
    gaps, more_gaps
        The first gaps, and how many more there are.
    """

    path: str
    run_id: str
    plant: str
    title: str
    driver: str
    whole: bool
    size_mb: float
    chunks: int
    start: str
    end: str
    timezone: str
    first_cycle: int
    last_cycle: int
    planned_cycles: int
    complete_cycles: int
    cycle_s: float
    simulated_s: float
    wall_s: float
    scheme: str
    actuator: str
    lockstep: bool
    pace: float
    versions: dict[str, str]
    origin: dict[str, str]
    recovery: dict[str, str]
    signals: tuple[SignalCount, ...]
    gaps: tuple[Gap, ...]
    more_gaps: int

    @property
    def messages(self) -> int:
        """Messages of all signals."""
        return sum(count.messages for count in self.signals)


class _Tally:
    """What has been seen of one port, and in which steps of cycles its messages are due."""

    __slots__ = ("cycle", "lost", "messages", "missing", "repeated", "sequence", "step")

    def __init__(self, step: int, before: int) -> None:
        self.step = step
        self.cycle = before
        self.sequence = -1
        self.messages = self.lost = self.repeated = self.missing = 0


class _Counting:
    """Counts messages port by port as they are read.

    Parameters
    ----------
    run
        The recording.
    cycles
        Those that are counted.
    """

    def __init__(self, run: RunReader, cycles: range) -> None:
        self.gaps: list[Gap] = []
        self.more_gaps = 0
        self.first_ns = self.last_ns = 0
        self.complete_cycles = 0
        self.tallies: dict[Port[Message], _Tally] = {}
        for port in sorted(run.ports(), key=str):
            step = due_step(run.plan, port)
            before = -(-cycles.start // step) * step - step if step else 0
            self.tallies[port] = _Tally(step, before)
        self._cycles = cycles
        self._stop_cycle = run.stop_cycle

    def see(self, record: RecordedMessage) -> None:
        """Take in a message."""
        tally = self.tallies[record.port]
        sequence, cycle = record.sequence, record.cycle
        tally.messages += 1
        if sequence <= tally.sequence:
            tally.repeated += 1
            return
        if tally.sequence >= 0:
            tally.lost += sequence - tally.sequence - 1
        elif self._cycles.start == 0:
            tally.lost += sequence
        tally.sequence = sequence
        if tally.step:
            if cycle > tally.cycle + tally.step:
                self._note(record.port, tally, cycle)
            tally.cycle = cycle
        self.first_ns = self.first_ns or record.log_time_ns
        self.last_ns = record.log_time_ns
        if record.port.signal is PRODUCTION:
            self.complete_cycles += 1

    def finish(self) -> None:
        """Look for what is missing at the end.

        Where the recording has the plant's word that the run is over, all cycles before it were
        due; otherwise those up to the last one that the plant completed.
        """
        if self._stop_cycle is None:
            (end,) = (
                tally.cycle + 1 for port, tally in self.tallies.items() if port.signal is PRODUCTION
            )
        else:
            end = min(self._stop_cycle, self._cycles.stop)
        for port, tally in self.tallies.items():
            if tally.step and end > tally.cycle + tally.step:
                self._note(port, tally, end)

    def _note(self, port: Port[Message], tally: _Tally, cycle: int) -> None:
        """Count the cycles from the last message on to one before a cycle."""
        first = tally.cycle + tally.step
        missing = len(range(first, cycle, tally.step))
        tally.missing += missing
        if len(self.gaps) < _LISTED_GAPS:
            self.gaps.append(Gap(str(port), first, first + (missing - 1) * tally.step, missing))
        else:
            self.more_gaps += 1


def read_overview(
    run: RunReader,
    cycles: range | None = None,
    follow: Callable[[float], None] = lambda share: None,
) -> Overview:
    """Go through a recording, message by message but without decoding them, and count.

    Parameters
    ----------
    run
        The recording.
    cycles
        Those to look at; None: all.
    follow
        Called every now and then with how far the reading has come, 0 to 1.

    Raises
    ------
    InputError
        The file is damaged.
    """
    wanted = range(max(run.last_cycle + 1, run.stop_cycle or 0)) if cycles is None else cycles
    counting = _Counting(run, wanted)
    for number, record in enumerate(run.records(cycles=cycles)):
        counting.see(record)
        if number % _FOLLOW_EVERY == 0:
            follow(run.read_share)
    counting.finish()
    return _overview(run, wanted, counting)


def _overview(run: RunReader, cycles: range, counting: _Counting) -> Overview:
    plan, origin = run.plan, run.metadata["run"]
    wall_s = (counting.last_ns - counting.first_ns) / 1e9
    lockstep = plan.lockstep
    return Overview(
        path=str(run.path),
        run_id=plan.run_id,
        plant=plan.plant,
        title=_title(run),
        driver=origin.get("driver", ""),
        whole=run.whole,
        size_mb=run.outline.size / 1e6,
        chunks=len(run.outline.chunks),
        start=run.clock.local(cycles.start).isoformat(),
        end=run.clock.local(max(cycles.stop - 1, cycles.start)).isoformat(),
        timezone=plan.timezone,
        first_cycle=cycles.start,
        last_cycle=cycles.stop - 1,
        planned_cycles=plan.cycles,
        complete_cycles=counting.complete_cycles,
        cycle_s=plan.cycle_ns / 1e9,
        simulated_s=len(cycles) * plan.cycle_ns / 1e9,
        wall_s=wall_s,
        scheme=plan.scheme,
        actuator=plan.actuator,
        lockstep=lockstep,
        pace=0.0 if lockstep else plan.cycle_ns / plan.cycle_wall_ns,
        versions={
            name.removeprefix("version "): text
            for name, text in origin.items()
            if name.startswith("version ")
        },
        origin={name: text for name, text in origin.items() if not name.startswith("version ")},
        recovery=run.metadata.get(RECOVERY_METADATA, {}),
        signals=tuple(
            _count(signal, counting.tallies, len(cycles), wall_s)
            for signal in SIGNALS
            if signal.logged
        ),
        gaps=tuple(counting.gaps),
        more_gaps=counting.more_gaps,
    )


def _count(
    signal: Signal[Message], tallies: dict[Port[Message], _Tally], cycles: int, wall_s: float
) -> SignalCount:
    """Add up what there is of one signal."""
    own = [tally for port, tally in tallies.items() if port.signal is signal]
    messages = sum(tally.messages for tally in own)
    return SignalCount(
        signal=signal.name,
        nodes=sum(1 for tally in own if tally.messages),
        messages=messages,
        per_cycle=messages / cycles if cycles else 0.0,
        per_s=messages / wall_s if wall_s else 0.0,
        lost=sum(tally.lost for tally in own),
        repeated=sum(tally.repeated for tally in own),
        missing_cycles=sum(tally.missing for tally in own),
    )


def _title(run: RunReader) -> str:
    """Return the title of the scenario that the recording carries, if it has one."""
    try:
        return str(tomllib.loads(run.scenario).get("title", ""))
    except tomllib.TOMLDecodeError:
        return ""
