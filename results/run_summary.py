"""The document of a run, `summary.json`: its figures of merit, counts and accounts."""

from __future__ import annotations

from pathlib import Path

import msgspec

from agents.plan import RunPlan
from agents.process.events import ExternalAccount
from bus_schemas.errors import InputError
from bus_schemas.signals import PRODUCTION
from recordings.inspect.health import Health, LauncherAccount, WrongMessages
from recordings.inspect.overview import read_overview
from recordings.read.reader import RunReader
from recordings.read.series import read_plant_series
from results.metrics import RunMetrics, run_metrics
from results.metrics.figures_of_merit import figures_json
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
            if wrong.cause == "conflicting" and wrong.publisher not in external
        )

    @property
    def is_incomplete(self) -> bool:
        """Whether messages, inputs or agents were missing at some time."""
        counts = self.lost, self.missing_inputs, self.skipped_cycles, self.recording_ended
        events = self.dropped, self.faults, self.wrong, self.restarts, self.takeovers
        return any((*counts, *events, *(device.is_troubled for device in self.devices)))

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
    if plan.timing.lockstep and not plan.restarts and not plan.elsewhere:
        return None
    try:
        with RunReader(recording) as run:
            return read_overview(run).health
    except InputError:
        return None
