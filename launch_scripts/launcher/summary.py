"""What a run came to: its figures and counts, as one document."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

import msgspec

from agents.events import Complaint, ExternalAccount, Recorded
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.signals import PRODUCTION
from launch_scripts.launcher.supervision import Child, Memory
from recordings.inspect.health import Health, LauncherAccount, WrongMessages
from recordings.inspect.overview import read_overview
from recordings.read.reader import RunReader
from recordings.read.series import read_plant_series
from studies.metrics import RunMetrics, run_metrics
from studies.metrics.figures_of_merit import figures_json
from sunspec.process import DeviceAccount


class MessageCount(msgspec.Struct, frozen=True):
    """Messages of one signal: published by the agents, found in the recording, and the rest."""

    signal: str
    published: int
    recorded: int

    @property
    def lost(self) -> int:
        """Published and not recorded; negative: recorded and not published."""
        return self.published - self.recorded


class MemoryUse(msgspec.Struct, frozen=True):
    """Memory of the median process of one kind [MB]: resident in all, and its own."""

    kind: str
    processes: int
    resident_median_mb: float
    own_median_mb: float


class ProcessAccount(msgspec.Struct, frozen=True):
    """What a process reported at its end, and the resources it used.

    dropped: Messages that it could not use, by cause.
    skipped_cycles: Cycles that were over before it came to them.
    cpu_s: Processor time from cycle 0 on [s].
    """

    agent: str
    kind: str
    dropped: dict[str, int]
    resident_mb: float
    skipped_cycles: int = 0
    cpu_s: float | None = None


class RunSummary(LauncherAccount, frozen=True, kw_only=True):
    """The figures of a run.

    `messages` are those of Heliarch's processes, `external` what was heard of external agents.
    `takeovers` counts how often a standby took each agent over. `health` is None if the recording
    was not read.
    """

    scenario: str
    driver: str
    folder: str
    sim_start: str
    cycles: int
    cycle_s: float
    wall_s: float
    startup_s: float
    metrics: RunMetrics | None
    messages: tuple[MessageCount, ...]
    missing_inputs: int
    memory: tuple[MemoryUse, ...]
    hindsight_neighbours: bool
    remarks: tuple[str, ...]
    interrupted: bool
    faults: dict[str, int] = msgspec.field(default_factory=dict)
    processes: tuple[ProcessAccount, ...] = ()
    external: tuple[ExternalAccount, ...] = ()
    devices: tuple[DeviceAccount, ...] = ()
    takeovers: dict[str, int] = msgspec.field(default_factory=dict)
    health: Health | None = None

    @property
    def cycles_per_s(self) -> float:
        return self.cycles / self.wall_s if self.wall_s > 0.0 else 0.0

    @property
    def recorded_cycles(self) -> int:
        """Cycles whose production is in the recording."""
        name = PRODUCTION.name
        own = sum(count.recorded for count in self.messages if count.signal == name)
        return own + sum(account.recorded.get(name, 0) for account in self.external)

    @property
    def lost(self) -> int:
        """Messages that were published and not recorded, or recorded and not published."""
        return self.lost_by_processes + sum(account.lost for account in self.external)

    @property
    def lost_by_processes(self) -> int:
        """Those of Heliarch's processes: a failure of the run."""
        return sum(abs(count.lost) for count in self.messages)

    @property
    def two_senders(self) -> tuple[WrongMessages, ...]:
        """Keys of Heliarch's processes on which another program sent messages as well."""
        external = {account.agent for account in self.external}
        return tuple(
            wrong
            for wrong in self.wrong
            if wrong.cause == "two senders" and wrong.publisher not in external
        )

    @property
    def troubled(self) -> bool:
        """Whether messages, inputs or agents were missing at some time."""
        counts = self.lost, self.missing_inputs, self.skipped_cycles, self.recording_ended
        found = self.dropped, self.faults, self.wrong, self.restarts, self.takeovers
        return any((*counts, *found, *(device.is_troubled for device in self.devices)))

    def as_json(self) -> bytes:
        """Return the summary as JSON, with the figures that follow from others."""
        document = msgspec.to_builtins(self)
        del document["health"]  # It follows from the recording: see `inspect`.
        document["cycles_per_s"] = self.cycles_per_s
        if self.metrics is not None:
            document["figures"] = figures_json(self.metrics)
        document["messages_lost"] = self.lost
        return msgspec.json.format(msgspec.json.encode(document), indent=2)


def recorded_metrics(recording: Path) -> RunMetrics | None:
    """Read the figures of merit; None if the recording has no complete cycle."""
    try:
        return run_metrics(read_plant_series(recording))
    except InputError:
        return None


def recorded_health(recording: Path, plan: RunPlan) -> Health | None:
    """Read the health of a run; None in lockstep, unless a process may be replaced or external."""
    if plan.lockstep and not plan.restarts and not plan.elsewhere:
        return None
    try:
        with RunReader(recording, skip_damaged=True) as run:
            return read_overview(run).health
    except InputError:
        return None


def count_messages(
    published: Mapping[str, int], recorded: Mapping[str, int]
) -> tuple[MessageCount, ...]:
    """Set what was published beside what was recorded, signal by signal."""
    signals = dict.fromkeys([*published, *recorded])
    return tuple(
        MessageCount(signal, published.get(signal, 0), recorded.get(signal, 0))
        for signal in signals
    )


def without_external(recorded: Recorded) -> dict[str, int]:
    """Return how many messages of Heliarch's processes were recorded, by signal.

    Messages of external agents do not count, nor those of strangers on keys of the processes.
    """
    counts = Counter(recorded.recorded)
    for account in recorded.external:
        counts.subtract(account.recorded)
    counts.subtract(recorded.extra)
    # A recording that had to end early may hold less than was heard.
    return {signal: max(count, 0) for signal, count in counts.items()}


def published_at_least(
    published: Mapping[str, int], heard: Mapping[str, int], health: Health | None, plan: RunPlan
) -> dict[str, int]:
    """Return what processes published of which some died, by signal.

    Nobody knows what those published: the numbers of the recorded messages tell.
    """
    sent = Counter(heard)
    for port in plan.wiring.ports:
        if health is not None and port.publisher not in plan.elsewhere:
            sent[port.signal.name] += health.lost.get(str(port), 0)
    return dict(sent | Counter(published))


def memory_use(samples: Iterable[tuple[str, Memory]]) -> tuple[MemoryUse, ...]:
    """Summarise the memory of processes, given with their kinds."""
    by_kind: dict[str, list[Memory]] = {}
    for kind, memory in samples:
        by_kind.setdefault(kind, []).append(memory)
    return tuple(
        MemoryUse(kind, len(values), *map(statistics.median, zip(*values, strict=True)))
        for kind, values in by_kind.items()
    )


def merge_counts(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for count in counts:
        total.update(count)
    return dict(total)


def count_causes(dropped: Iterable[tuple[str, str, int]]) -> dict[str, int]:
    """Count dropped messages, given as port, cause and number, by cause."""
    counts: Counter[str] = Counter()
    for _, cause, number in dropped:
        counts[cause] += number
    return dict(counts)


def process_account(child: Child) -> ProcessAccount:
    """Return the account of a process that has ended."""
    finished, cpu_s, before_s = child.finished, child.cpu_s(), child.cpu_at_start_s
    return ProcessAccount(
        child.agent,
        child.kind,
        dropped=count_causes(finished.dropped) if finished else {},
        resident_mb=child.memory.resident_mb,
        skipped_cycles=finished.skipped_cycles if finished else 0,
        cpu_s=None if before_s is None or cpu_s is None else cpu_s - before_s,
    )


def wrong_messages(
    plan: RunPlan,
    complaints: Iterable[Complaint],
    dropped: Iterable[tuple[str, str, int]],
) -> tuple[WrongMessages, ...]:
    """Return the wrong messages of a run by key and cause, the most frequent first.

    The recorder complains of what it hears, and agents have `dropped` (port, cause and number) what
    they could not use. Both may have counted the same message: the larger count holds. Of what was
    dropped only that of external agents counts: other late messages are the machine's fault.
    """
    publishers = {str(port): port.publisher for port in plan.wiring.ports}
    theirs = {port for port, publisher in publishers.items() if publisher in plan.external}
    counts: Counter[tuple[str, str]] = Counter()
    for port, cause, count in dropped:
        if port in theirs:
            counts[port, cause] += count
    examples = dict.fromkeys(counts, "dropped by an agent")
    for complaint in complaints:
        place = (complaint.key.removeprefix(f"{plan.plant}/"), complaint.cause)
        counts[place] = max(counts[place], complaint.count)
        examples[place] = complaint.example
    return tuple(
        WrongMessages(key, cause, count, examples[key, cause], publishers.get(key, ""))
        for (key, cause), count in counts.most_common()
    )
