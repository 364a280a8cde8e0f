"""The document of a run, `summary.json`: its figures of merit, counts and accounts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypeAlias

import msgspec
from msgspec.structs import replace

from bus_schemas.codec import UNREADABLE
from bus_schemas.errors import listed
from recordings.inspect.overview import Overview, read_overview
from recordings.read.reader import RunReader
from recordings.read.run_file import FAILURE_NAME, SUMMARY_NAME
from results.answers import Answer
from results.figures import Figures
from results.highlights import Highlights
from results.plants import PlantFigures
from sunspec.process import DeviceAccount

End: TypeAlias = Literal["failed", "interrupted", "unfinished", "over"]
"""Given up by its launcher; ended early; not shown to have ended; ended as planned."""

_NONE: Final = f"there is no {SUMMARY_NAME} beside the recording"

_MOST_REFUSED: Final = 0.1
"""Share of its messages that may be refused of an external agent: more is a failure."""


class WrongMessages(msgspec.Struct, frozen=True):
    """Messages of one key that were wrong in one way, with an explanation of the first one.

    `publisher` is the agent that may publish on the key; empty: the run has no such key.
    """

    key: str
    cause: str
    count: int
    example: str
    publisher: str = ""


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


class ExternalAccount(msgspec.Struct, frozen=True):
    """What the recording of a run that is over holds of an external agent.

    recorded: Its messages in the recording, by signal.
    lost: Its messages that their sequence numbers show to be missing.
    expected, answered: How many messages should have come on the keys with one in each cycle, and
        how many came.
    late: In real time: how many stages' answers came too late for a listener.
    findings: What was wrong with its decisions, and in real time with the times of its answers, in
        words: each with its name, and the first key and cycle.
    """

    agent: str
    recorded: dict[str, int] = {}
    lost: int = 0
    expected: int = 0
    answered: int = 0
    late: int = 0
    findings: tuple[str, ...] = ()


class RunDocument(msgspec.Struct, frozen=True, kw_only=True):
    """What became of a run: its end, counts, figures, health and answers.

    scenario, driver, folder, sim_start, planned_cycles, cycle_s: What was run, where and how.
    offset_kw, offset_errors: How much more than the dispatch the plant aimed at, as in its plan.
    cycles: How many were completed.
    dropped: Messages that agents could not use, by cause.
    restarts: How often each agent was started again.
    given_up: Processes that were not started again, and since which cycle.
    recording_ended: Why the recording does not hold the run as a whole.
    figures, highlights: None if no cycle can be read in the recording.
    plants: Those of a fleet.
    messages: Those of Heliarch's processes.
    external: What was heard of external agents.
    recording: What the recording holds; None if it could not be read.
    answers: Those of the plant, to orders and steps of the schedule.
    """

    run_id: str
    scenario: str
    driver: str
    folder: str
    sim_start: str
    planned_cycles: int
    cycle_s: float
    remarks: tuple[str, ...] = ()
    offset_kw: float = 0.0
    offset_errors: float = 0.0
    cycles: int = 0
    wall_s: float = 0.0
    startup_s: float = 0.0
    interrupted: bool = False
    dropped: dict[str, int] = {}
    restarts: dict[str, int] = {}
    given_up: dict[str, int] = {}
    recording_ended: str = ""
    wrong: tuple[WrongMessages, ...] = ()
    figures: Figures | None = None
    plants: tuple[PlantFigures, ...] = ()
    messages: tuple[MessageCount, ...] = ()
    processes: tuple[ProcessAccount, ...] = ()
    external: tuple[ExternalAccount, ...] = ()
    devices: tuple[DeviceAccount, ...] = ()
    recording: Overview | None = None
    answers: tuple[Answer, ...] = ()
    highlights: Highlights | None = None

    @property
    def cycles_per_s(self) -> float:
        return self.cycles / self.wall_s if self.wall_s > 0.0 else 0.0

    @property
    def recording_gaps(self) -> list[range]:
        """The cycles in which the recorder did not hear the plant."""
        spans = self.recording.unrecorded if self.recording else ()
        return [range(span.first_cycle, span.end) for span in spans]

    @property
    def skipped_cycles(self) -> int:
        """Cycles that were over before a process came to them."""
        return sum(process.skipped_cycles for process in self.processes)

    @property
    def missing_inputs(self) -> int:
        return self.recording.missing_inputs if self.recording else 0

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
        counts = self.lost, self.missing_inputs, self.skipped_cycles, self.recording_ended
        events = self.dropped, self.wrong, self.restarts, self.given_up, self.recording_gaps
        return any((*counts, *events, *(device.has_faults for device in self.devices)))

    def refused(self, account: ExternalAccount) -> int:
        """Return how many messages of an external agent were wrong, copies left out."""
        wrong = (one for one in self.wrong if one.publisher == account.agent)
        return sum(one.count for one in wrong if one.cause != "duplicate")

    def failures(self) -> Iterator[str]:
        """Yield in a line each why the run cannot be relied on; nothing if it can."""
        if self.recording_ended:
            yield self.recording_ended
        if self.given_up:
            yield f"given up in the run: {listed([*self.given_up])}"
        if self.recording_gaps:
            spans = [f"{span.start:,} to {span.stop - 1:,}" for span in self.recording_gaps]
            yield f"the recorder did not hear the plant: not recorded are cycles {listed(spans)}"
        if missed := sum(bool(answer.missed) for answer in self.answers):
            yield f"{missed} of {len(self.answers)} answers of the plant missed a budget"
        if attacked := self._two_senders():
            text = listed([f"{one.key}: {one.example}" for one in attacked])
            yield f"another program than its own sent messages on {text}"
        if self.lost_by_processes and not self.recording_ended:
            lost = ", ".join(count.signal for count in self.messages if count.lost)
            yield f"messages were lost: {lost}"
        for account in self.external:
            refused = self.refused(account)
            of = max(sum(account.recorded.values()), account.expected, refused)
            if refused > _MOST_REFUSED * of:
                most = next(one for one in self.wrong if one.publisher == account.agent)
                yield (
                    f"external agent {account.agent}: {refused:,} of {of:,} messages refused, "
                    f"most: {most.key} {most.cause} ({most.example})"
                )
            yield from account.findings

    def _two_senders(self) -> list[WrongMessages]:
        """Return keys on which a program sent messages that are not its own.

        A device that takes part must keep to its keys; strangers on others do no harm.
        """
        external = {account.agent for account in self.external}
        causes = {"conflicting", *(("wrong_sender", "unknown") if external else ())}
        wrong = (one for one in self.wrong if one.cause in causes)
        return [one for one in wrong if one.publisher not in external]

    def as_json(self) -> bytes:
        """Return the summary as JSON, with the numbers that follow from others."""
        derived = {
            "cycles_per_s": self.cycles_per_s,
            "missing_inputs": self.missing_inputs,
            "skipped_cycles": self.skipped_cycles,
            "messages_lost": self.lost,
        }
        document = msgspec.to_builtins(self) | derived
        return msgspec.json.format(msgspec.json.encode(document), indent=2)


def document_in(folder: Path, run_id: str) -> tuple[RunDocument | None, str]:
    """Return the document of a run in a folder, or why there is none."""
    try:
        document = msgspec.json.decode((folder / SUMMARY_NAME).read_bytes(), type=RunDocument)
    except FileNotFoundError:
        return None, _NONE
    except (OSError, *UNREADABLE) as error:
        found = f"{SUMMARY_NAME} is damaged or of another version of Heliarch ({error})"
    else:
        if document.run_id == run_id:
            return document, ""
        found = f"{SUMMARY_NAME} is of another run, {document.run_id}"
    return None, f"{found}: run the scenario again to make it anew"


def failure_in(folder: Path) -> str:
    """Return in a line why the run in a folder failed; empty: it did not."""
    try:
        text = (folder / FAILURE_NAME).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return " ".join(text.split())


class Outcome(NamedTuple):
    """How a run ended: every command, page and report asks here.

    The document and the failure are in the run's folder, `stop_cycle` is in its recording: none of
    them is there while the run goes on. `planned_cycles` counts where there is no document, and
    `undocumented` says why.
    """

    document: RunDocument | None = None
    failure: str = ""
    stop_cycle: int | None = None
    planned_cycles: int = 0
    undocumented: str = _NONE

    @property
    def _cycles(self) -> tuple[int | None, int]:
        """Number of cycles that took place, None if unknown, and of those planned."""
        if self.document is None:
            return self.stop_cycle, self.planned_cycles
        return self.document.cycles, self.document.planned_cycles

    @property
    def kind(self) -> End:
        cycles, planned = self._cycles
        if self.failure:
            return "failed"
        if cycles is None:
            return "unfinished"
        is_asked = self.document is not None and self.document.interrupted
        return "interrupted" if is_asked or cycles < planned else "over"

    @property
    def text(self) -> str:
        document, (cycles, planned) = self.document, self._cycles
        parts = []
        match self.kind:
            case "failed":
                return f"failed: {self.failure}"
            case "unfinished":
                return "the recording stops before the run's end"
            case "interrupted":
                how = "interrupted" if document is None or document.interrupted else "ended early,"
                parts.append(f"{how} after {cycles:,} of {planned:,} cycles")
        if document is not None and document.given_up:
            parts.append(f"given up: {listed([*document.given_up])}")
        if document is not None and (document.recording_ended or document.recording_gaps):
            parts.append(document.recording_ended or "recording has gaps")
        return "; ".join(parts) or "over"


def outcome_of(run: RunReader) -> Outcome:
    folder, planned = run.path.parent, run.plan.timing.cycles
    document, why_not = document_in(folder, run.plan.run_id)
    return Outcome(document, failure_in(folder), run.stop_cycle, planned, why_not)


def overview_of(run: RunReader) -> Overview:
    """Return what a recording holds: as known since the end of the run, or else by reading it."""
    document, _ = document_in(run.path.parent, run.plan.run_id)
    if document is not None and document.recording is not None:
        known_ns = run.path.with_name(SUMMARY_NAME).stat().st_mtime_ns
        is_newest = known_ns >= max((stat.st_mtime_ns for stat in run.stats()), default=0)
        if is_newest and document.recording.files == len(run.files):  # None was deleted since.
            return replace(document.recording, path=str(run.path))
    return read_overview(run)
