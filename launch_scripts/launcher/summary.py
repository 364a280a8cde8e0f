"""What a run came to: its figures and counts, as one document."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import msgspec

from agents.events import ExternalAccount, Recorded
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
    """Memory of the processes of one kind, the median process and the largest [MB]."""

    kind: str
    processes: int
    resident_median_mb: float
    resident_largest_mb: float
    own_median_mb: float


class ProcessAccount(msgspec.Struct, frozen=True):
    """What one process of a run over processes said at its end, and what it took.

    agent, kind: Its name, and `recorder`, `plant`, `central`, `supervisor` or `direct`.
    dropped: Messages that it could not use, by cause.
    resident_mb: Most memory that was seen resident [MB].
    skipped_cycles: Cycles that were over before it came to them.
    cpu_s: Processor time from cycle 0 to its end [s].
    """

    agent: str
    kind: str
    dropped: dict[str, int]
    resident_mb: float
    skipped_cycles: int = 0
    cpu_s: float | None = None


class RunSummary(LauncherAccount, frozen=True, kw_only=True):
    """The figures of a run.

    `processes` is empty if the run was in one process. `messages` are those of the processes;
    `external` is what was heard of external agents, which report nothing about themselves.
    `devices` is what the gateway measured, `takeovers` how often a standby took each agent over.
    `health` is None if the recording was not read.
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
    old_inputs: int = 0
    processes: tuple[ProcessAccount, ...] = ()
    external: tuple[ExternalAccount, ...] = ()
    devices: tuple[DeviceAccount, ...] = ()
    takeovers: dict[str, int] = msgspec.field(default_factory=dict)
    health: Health | None = None

    @property
    def cycles_per_s(self) -> float:
        """Cycles per second of wall time, arming left out."""
        return self.cycles / self.wall_s if self.wall_s > 0.0 else 0.0

    @property
    def recorded_cycles(self) -> int:
        """Cycles whose production is in the recording."""
        name = PRODUCTION.name
        own = sum(count.recorded for count in self.messages if count.signal == name)
        return own + sum(account.recorded.get(name, 0) for account in self.external)

    @property
    def lost(self) -> int:
        """Messages that were published and not recorded, or recorded and not published.

        Processes count what they publish. Of external agents the numbers of their messages tell.
        """
        return self.lost_by_processes + sum(account.lost for account in self.external)

    @property
    def lost_by_processes(self) -> int:
        """Those of the launcher's own processes, which is a failure of the run."""
        return sum(abs(count.lost) for count in self.messages)

    @property
    def two_senders(self) -> tuple[WrongMessages, ...]:
        """Keys of the launcher's own processes on which another program sent messages as well."""
        external = {account.agent for account in self.external}
        return tuple(
            wrong
            for wrong in self.wrong
            if wrong.cause == "two senders" and wrong.publisher not in external
        )

    @property
    def troubled(self) -> bool:
        """Whether messages, inputs or agents were missing at some time."""
        return bool(
            self.lost
            or self.missing_inputs
            or self.skipped_cycles
            or self.recording_ended
            or any(device.is_troubled for device in self.devices)
            or any((self.dropped, self.faults, self.wrong, self.restarts, self.takeovers))
        )

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
    """Read the figures of merit from a closed recording; None if it has no complete cycle."""
    try:
        return run_metrics(read_plant_series(recording))
    except InputError:
        return None


def recorded_health(recording: Path, plan: RunPlan) -> Health | None:
    """Return the health of a run from its recording; None if it needs no look or cannot be read.

    In lockstep nothing can be missing, unless a process was replaced or is not Heliarch's.
    """
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


def memory_use(samples: Mapping[str, list[Memory]]) -> tuple[MemoryUse, ...]:
    """Summarise the largest memory seen of each process, kind by kind."""
    return tuple(
        MemoryUse(
            kind,
            len(values),
            statistics.median(value.resident_mb for value in values),
            max(value.resident_mb for value in values),
            statistics.median(value.own_mb for value in values),
        )
        for kind, values in samples.items()
    )


def merge_counts(counts: list[dict[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for count in counts:
        total.update(count)
    return dict(total)


def process_account(child: Child) -> ProcessAccount:
    """Return the account of a process that has ended."""
    finished, cpu_s, before_s = child.finished, child.cpu_s(), child.cpu_at_start_s
    dropped: Counter[str] = Counter()
    for _, cause, number in finished.dropped if finished else ():
        dropped[cause] += number
    return ProcessAccount(
        child.agent,
        child.kind,
        dropped=dict(dropped),
        resident_mb=child.memory.resident_mb,
        skipped_cycles=finished.skipped_cycles if finished else 0,
        cpu_s=None if before_s is None or cpu_s is None else cpu_s - before_s,
    )
