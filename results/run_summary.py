"""The document of a run, `summary.json`: its figures of merit, counts and accounts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import msgspec

from agents.plan import RunPlan
from agents.process.events import ExternalAccount
from bus_schemas.errors import listed
from recordings.inspect.health import Health, RunDocument, WrongMessages
from recordings.inspect.overview import keep_overview
from recordings.read.counting import RecordingCount
from recordings.read.reader import RunReader
from recordings.read.series import plant_series_of
from results.answers import Answer, answers, judged
from results.figures import Figures, run_figures
from results.highlights import Highlights, highlights
from scenarios.scenario import AnswerBudgets
from sunspec.process import DeviceAccount

_MOST_REFUSED: Final = 0.1
"""Share of its messages that may be refused of an external agent: more is a failure."""


class MessageCount(msgspec.Struct, frozen=True):
    """Messages of one signal: published by the agents, found in the recording, and the rest."""

    signal: str
    published: int
    recorded: int

    @property
    def lost(self) -> int:
        """Published and not recorded; negative: recorded and not published."""
        return self.published - self.recorded


class ProcessAccount(msgspec.Struct, frozen=True):
    """What a process reported at its end, and the resources it used.

    dropped: Messages that it could not use, by cause.
    resident_mb: Its largest memory; 0 of one that did not end.
    own_mb: What it shared with no other process at its end; 0: not known, or killed.
    skipped_cycles: Cycles that were over before it came to them.
    cpu_s: Processor time from cycle 0 on [s].
    """

    agent: str
    kind: str
    dropped: dict[str, int]
    resident_mb: float
    own_mb: float = 0.0
    skipped_cycles: int = 0
    cpu_s: float | None = None


class RunFacts(msgspec.Struct, frozen=True):
    """What was run: of `planned_cycles` cycles, with clusters maybe chosen in hindsight.

    offset_kw, offset_errors: How much more than the dispatch the plant aimed at, as in its plan.
    """

    scenario: str
    driver: str
    folder: str
    sim_start: str
    planned_cycles: int
    cycle_s: float
    hindsight_neighbours: bool = False
    remarks: tuple[str, ...] = ()
    offset_kw: float = 0.0
    offset_errors: float = 0.0


class RunSummary(RunDocument, frozen=True, kw_only=True):
    """The figures of a run.

    `cycles` were completed. `figures` is None if none of them can be read in the recording.
    `messages` are those of Heliarch's processes, `external` what was heard of external agents.
    `health` is None if the recording was not read for it. `answers` are the plant's, to orders and
    steps of the schedule. `highlights` are None without figures.
    """

    run: RunFacts
    cycles: int
    wall_s: float
    startup_s: float
    figures: Figures | None
    messages: tuple[MessageCount, ...]
    processes: tuple[ProcessAccount, ...] = ()
    external: tuple[ExternalAccount, ...] = ()
    devices: tuple[DeviceAccount, ...] = ()
    health: Health | None = None
    answers: tuple[Answer, ...] = ()
    highlights: Highlights | None = None

    @property
    def cycles_per_s(self) -> float:
        return self.cycles / self.wall_s if self.wall_s > 0.0 else 0.0

    @property
    def missing_inputs(self) -> int:
        return self.health.missing_inputs if self.health else 0

    @property
    def lost(self) -> int:
        """Messages that were published and not recorded, or recorded and not published."""
        return self.lost_by_processes + sum(account.lost for account in self.external)

    @property
    def lost_by_processes(self) -> int:
        """Those of Heliarch's processes: a failure of the run."""
        return sum(abs(count.lost) for count in self.messages)

    @property
    def is_incomplete(self) -> bool:
        """Whether messages, inputs or agents were missing at some time."""
        launcher = self.launcher
        counts = self.lost, self.missing_inputs, launcher.skipped_cycles, launcher.recording_ended
        events = launcher.dropped, launcher.wrong, launcher.restarts
        lacks = launcher.given_up, launcher.recording_gaps
        return any((*counts, *events, *lacks, *(device.has_faults for device in self.devices)))

    def refused(self, account: ExternalAccount) -> int:
        """Return how many messages of an external agent were refused, but for those too late."""
        wrong = (one for one in self.launcher.wrong if one.publisher == account.agent)
        return sum(one.count for one in wrong if one.cause not in {"late", "duplicate"})

    def failures(self) -> Iterator[str]:
        """Yield in a line each why the run cannot be relied on; nothing if it can."""
        launcher = self.launcher
        if launcher.recording_ended:
            yield launcher.recording_ended
        if launcher.given_up:
            yield f"given up in the run: {listed([*launcher.given_up])}"
        if launcher.recording_gaps:
            spans = [f"{first:,} to {last:,}" for first, last in launcher.recording_gaps]
            yield f"the recorder was cut off: not recorded are cycles {listed(spans)}"
        if missed := sum(bool(answer.missed) for answer in self.answers):
            yield f"{missed} of {len(self.answers)} answers of the plant missed a budget"
        if attacked := self._two_senders():
            text = listed([f"{one.key}: {one.example}" for one in attacked])
            yield f"more than one program sent messages on {text}"
        if self.lost_by_processes and not launcher.recording_ended:
            lost = ", ".join(count.signal for count in self.messages if count.lost)
            yield f"messages were lost: {lost}"
        for account in self.external:
            refused = self.refused(account)
            of = max(sum(account.recorded.values()), account.expected, refused)
            if refused > _MOST_REFUSED * of:
                yield f"external agent {account.agent}: {refused:,} of {of:,} messages refused"
            if account.differing:
                yield (
                    f"external agent {account.agent}: {account.differing:,} messages differ from "
                    f"what it must decide, see heliarch verify {self.run.folder}"
                )

    def _two_senders(self) -> list[WrongMessages]:
        """Return keys of Heliarch's processes on which another program sent messages as well."""
        external = {account.agent for account in self.external}
        conflicting = (one for one in self.launcher.wrong if one.cause == "conflicting")
        return [one for one in conflicting if one.publisher not in external]

    def as_json(self) -> bytes:
        """Return the summary as JSON, with the numbers that follow from others."""
        derived = {
            "cycles_per_s": self.cycles_per_s,
            "missing_inputs": self.missing_inputs,
            "messages_lost": self.lost,
        }
        document = msgspec.to_builtins(self) | derived
        return msgspec.json.format(msgspec.json.encode(document), indent=2)


def recorded_figures(
    recording: Path, budgets: AnswerBudgets | None = None
) -> tuple[Figures, tuple[Answer, ...], Highlights]:
    """Read figures of merit, answers and highlights.

    Raises InputError: The recording has none to show.
    """
    with RunReader(recording) as run:
        series = plant_series_of(run)
    return run_figures(series), judged(answers(series), budgets), highlights(series)


def recorded_health(recording: Path, plan: RunPlan, count: RecordingCount) -> Health | None:
    """Keep an overview of a recording; return the health, where anything can be late or missing."""
    if plan.timing.lockstep and not plan.restarts and not plan.elsewhere:
        keep_overview(recording, count)
        return None
    return keep_overview(recording).health
