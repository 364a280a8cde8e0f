"""The account of a run: what its driver finds out while it goes on, and the summary at its end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from msgspec.structs import replace

from agents.plan import RunPlan
from agents.process.events import ExternalAccount, Finished, Recorded
from bus_schemas.errors import InputError
from bus_schemas.signals import PRODUCTION
from bus_schemas.tree import PLANT, ROOT
from launch_scripts.process_record import Process
from launch_scripts.run_folder import RunFolder
from recordings.inspect.overview import Reading, read_through
from recordings.read.gaps import due_step
from recordings.read.reader import RunReader
from recordings.read.series import RunSeries, collected, plant_collector
from recordings.verify.verification import verify
from results.answers import answers, judged
from results.figures import run_figures
from results.highlights import highlights
from results.run_document import (
    LauncherAccount,
    MessageCount,
    ProcessAccount,
    RunDocument,
    RunFacts,
    WrongMessages,
)
from results.timing.devices import devices_of
from results.timing.stages import stage_table
from scenarios.preparation import Preparation
from sunspec.process import DeviceAccount


@dataclass
class RunAccount:
    """What is known of a run so far.

    asked_at, armed_at: When the user asked for the run and when cycle 0 began, monotonic [s].
    published: Messages of Heliarch's processes, by signal.
    is_complete: Whether every process has said what it published.
    dropped: Messages that processes could not use: port, cause and number.
    restarts: How often each process was started again.
    given_up: Processes that were not started again, and since which cycle.
    recording_gaps: First and last cycle of what the recorder did not hear in time.
    """

    preparation: Preparation
    folder: RunFolder
    driver: str
    asked_at: float
    armed_at: float = 0.0
    published: Counter[str] = field(default_factory=Counter)
    is_complete: bool = True
    dropped: list[tuple[str, str, int]] = field(default_factory=list)
    processes: list[ProcessAccount] = field(default_factory=list)
    restarts: Counter[str] = field(default_factory=Counter)
    given_up: dict[str, int] = field(default_factory=dict)
    recording_gaps: list[tuple[int, int]] = field(default_factory=list)

    def add_process(self, process: Process) -> None:
        finished = process.finished or Finished({}, [])
        self.dropped += finished.dropped
        self.processes.append(
            ProcessAccount(
                process.name,
                process.kind,
                _by_cause(finished.dropped),
                process.exited.resident_mb if process.exited else 0.0,
                (process.recorded or finished).own_mb,
                skipped_cycles=finished.skipped_cycles,
                cpu_s=process.cpu_in_run_s(),
            )
        )

    def document(
        self,
        recorded: Recorded,
        wall_s: float,
        *,
        interrupted: bool,
        devices: tuple[DeviceAccount, ...] = (),
    ) -> RunDocument:
        """Return what became of the run, which has ended. Its recording is read through once."""
        preparation, plan = self.preparation, self.preparation.plan
        reading, series, fault = self._read(recorded)
        budgets = preparation.scenario.scenario.answers
        external = [
            external_account(plan, agent, recorded.cycles, reading)
            for agent in plan.elsewhere
            if reading
        ]
        dropped = _by_cause(self.dropped)
        if recorded.foreign:
            dropped["at the recorder"] = recorded.foreign
        return RunDocument(
            run_id=plan.run_id,
            run=RunFacts(
                scenario=plan.plant,
                driver=self.driver,
                folder=str(self.folder.path),
                sim_start=preparation.local_start(),
                planned_cycles=plan.timing.cycles,
                cycle_s=plan.timing.cycle_ns / 1e9,
                hindsight_neighbours=preparation.hindsight,
                remarks=preparation.remarks,
                offset_kw=preparation.plan.control.offset_kw,
                offset_errors=preparation.plan.control.offset_errors,
            ),
            launcher=LauncherAccount(
                dropped=dropped,
                restarts=dict(self.restarts),
                given_up=self.given_up,
                recording_gaps=tuple(self._unrecorded(reading)),
                skipped_cycles=sum(process.skipped_cycles for process in self.processes),
                recording_ended=recorded.ended_early or fault,
                wrong=self._wrong_messages(recorded),
                interrupted=interrupted,
            ),
            cycles=recorded.cycles,
            wall_s=wall_s,
            startup_s=self.armed_at - self.asked_at,
            figures=run_figures(series) if series else None,
            messages=self._messages(recorded, external, reading),
            processes=tuple(self.processes),
            external=tuple(map(self._compared, external)),
            devices=devices,
            recording=reading.overview if reading else None,
            answers=judged(answers(series), budgets) if series else (),
            highlights=highlights(series) if series else None,
        )

    def _read(self, recorded: Recorded) -> tuple[Reading | None, RunSeries | None, str]:
        """Read the recording; return also what is wrong with it in a line, empty if all is well."""
        plan, path = self.preparation.plan, self.folder.recording
        is_sure = plan.timing.lockstep and not plan.restarts and not plan.elsewhere
        collector, series = plant_collector(plan), None
        try:
            with RunReader(path) as run:
                only_count = is_sure and run.whole
                reading = read_through(run, listener=collector, only_count=only_count)
                if recorded.cycles:
                    with suppress(InputError):  # It has no complete cycle.
                        series = collected(collector, run)
        except (InputError, OSError) as error:
            return None, None, f"the recording cannot be read: {error}"
        found, reported = reading.by_signal(), Counter(recorded.recorded)
        if reported - found:
            of = f"{found.total():,} of {reported.total():,} messages that were recorded"
            return reading, series, f"{path}: it holds {of}"
        return reading, series, ""

    def _compared(self, account: ExternalAccount) -> ExternalAccount:
        """Return the account of an external agent with its timing, and with what differs."""
        plan = self.preparation.plan
        if not plan.timing.lockstep and not plan.faults.device:
            account = _timed(account, self.folder.recording)
        if account.agent not in plan.tree.leaves or plan.faults.device:
            return account
        try:
            result = verify(self.folder.recording, account.agent).agents[account.agent]
        except InputError:  # There is nothing to compare.
            return account
        return replace(account, differing=result.differences["differs"])

    def _unrecorded(self, reading: Reading | None) -> Iterator[tuple[int, int]]:
        """Yield first and last cycle of each gap, without cycles whose messages came late."""
        produced = reading.gaps[PRODUCTION.of(ROOT)] if reading else None
        for first, last in self.recording_gaps:
            cycles = range(first, last + 1)
            lacking = [cycle for cycle in cycles if not (produced and produced.has(cycle))]
            if lacking:
                yield lacking[0], lacking[-1]

    def _messages(
        self, recorded: Recorded, external: list[ExternalAccount], reading: Reading | None
    ) -> tuple[MessageCount, ...]:
        """Return what Heliarch's processes published, and what of that is recorded.

        What a process that died had published is unknown: the sequence numbers of the recorded
        messages show the least that it can be.
        """
        plan, published = self.preparation.plan, self.published
        heard = reading.by_signal() if reading else Counter[str]()
        for account in external:
            heard.subtract(account.recorded)
        heard.subtract(recorded.extra)  # Of strangers, on keys of the processes.
        # A recording that had to end early may hold less than was heard.
        heard = Counter({signal: max(count, 0) for signal, count in heard.items()})
        if not self.is_complete:
            numbered = Counter(heard)
            for port in plan.wiring.ports:
                if reading is not None and port.publisher not in plan.elsewhere:
                    lost = reading.overview.health.lost
                    numbered[port.signal.name] += lost.get(str(port), 0)
            published = numbered | published
        return tuple(
            MessageCount(signal, published[signal], heard[signal])
            for signal in dict.fromkeys([*published, *heard])
        )

    def _wrong_messages(self, recorded: Recorded) -> tuple[WrongMessages, ...]:
        """Return the wrong messages by key and cause, the most frequent first, each once.

        The recorder hears each message once and names its first cause. An agent may have dropped
        the same message for another cause: only what agents dropped beyond that is added. Of what
        was dropped only that of external agents counts: other late messages are the machine's
        fault.
        """
        plan = self.preparation.plan
        publishers = {str(port): port.publisher for port in plan.wiring.ports}
        dropped: Counter[tuple[str, str]] = Counter()
        for port, cause, count in self.dropped:  # Several listeners drop one message.
            if publishers.get(port) in plan.access.external:
                dropped[port, cause] = max(dropped[port, cause], count)
        counts: Counter[tuple[str, str]] = Counter()
        examples = dict.fromkeys(dropped, "dropped by an agent")
        for complaint in recorded.complaints:
            of = (complaint.key.removeprefix(f"{plan.plant}/"), complaint.cause)
            counts[of] += complaint.count
            examples[of] = complaint.example
        unmatched: Counter[str] = Counter()  # Complaints about messages dropped for other causes.
        for (key, _), count in (counts - dropped).items():
            unmatched[key] += count
        for of, count in (dropped - counts).most_common():
            same = min(unmatched[of[0]], count)
            unmatched[of[0]] -= same
            counts[of] += count - same
        return tuple(
            WrongMessages(key, cause, count, examples[key, cause], publishers.get(key, ""))
            for (key, cause), count in (+counts).most_common()
        )


def _by_cause(dropped: list[tuple[str, str, int]]) -> dict[str, int]:
    counts: Counter[str] = Counter()
    for _, cause, number in dropped:
        counts[cause] += number
    return dict(counts)


def external_account(plan: RunPlan, agent: str, cycles: int, reading: Reading) -> ExternalAccount:
    """Return the account of an external agent from the recording of a run of `cycles` cycles."""
    own = {port: one for port, one in reading.gaps.items() if port.publisher == agent}
    due = {port: -(-cycles // step) for port in own if (step := due_step(plan, port))}
    return ExternalAccount(
        agent,
        recorded=dict(reading.by_signal(agent)),
        lost=sum(one.lost for one in own.values()),
        expected=sum(due.values()),
        answered=sum(own[port].cycles(cycles) for port in due),
    )


def _timed(account: ExternalAccount, recording: Path) -> ExternalAccount:
    """Return the account of an external controller with the times of its answers."""
    try:
        with RunReader(recording) as reader:
            timings = devices_of(stage_table(reader, ()), reader.plan)
    except InputError:  # There is nothing to measure.
        return account
    found = {one.agent: one for one in timings}.get(account.agent)
    if found is None or account.agent == PLANT:
        return account
    wrong = found.findings if found.is_wrong else ()
    return replace(account, late=found.late, timing=wrong)
