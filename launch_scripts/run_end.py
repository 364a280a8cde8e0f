"""What became of a run, worked out once, after its end, in one pass over its recording."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from pathlib import Path

from msgspec.structs import replace

from agents.plan import RunPlan
from agents.process.events import Finished, Recorded
from bus_schemas.errors import InputError
from bus_schemas.tree import PLANT
from launch_scripts.process_record import Process
from launch_scripts.run_folder import RunFolder
from recordings.inspect.overview import Gaps, Overview, read_through
from recordings.read.gaps import due_step
from recordings.read.reader import RunReader
from recordings.read.series import RunSeries, SeriesCollector, collected, columns_of
from recordings.verify.verification import verify
from results.answers import answers, judged
from results.figures import run_figures
from results.highlights import highlights
from results.plants import plant_figures
from results.run_document import (
    ExternalAccount,
    MessageCount,
    ProcessAccount,
    RunDocument,
    WrongMessages,
)
from results.timing.devices import devices_of
from results.timing.stages import stage_table
from scenarios.preparation import Preparation

Dropped = list[tuple[str, str, int]]
"""Messages that processes could not use: port, cause and number."""


def begun(preparation: Preparation, folder: RunFolder, driver: str) -> RunDocument:
    """Return the document of a run that begins."""
    plan = preparation.plan
    return RunDocument(
        run_id=plan.run_id,
        scenario=plan.plant,
        driver=driver,
        folder=str(folder.path),
        sim_start=preparation.local_start(),
        planned_cycles=plan.timing.cycles,
        cycle_s=plan.timing.cycle_ns / 1e9,
        remarks=preparation.remarks,
        offset_kw=plan.control.offset_kw,
        offset_errors=plan.control.offset_errors,
    )


def ended(
    document: RunDocument,
    preparation: Preparation,
    recorded: Recorded,
    published: Counter[str],
    dropped: Dropped,
    *,
    is_complete: bool = True,
) -> RunDocument:
    """Add to a document what recorder and recording say of the run.

    published: Messages of Heliarch's processes, by signal.
    is_complete: Whether all of these processes have said what they published.
    """
    plan, path = preparation.plan, Path(document.folder)
    overview, gaps, series, fault = _read(preparation, path, recorded)
    external = [
        external_account(plan, agent, recorded.cycles, gaps) for agent in plan.elsewhere if gaps
    ]
    by_cause = _by_cause(dropped)
    if recorded.foreign:
        by_cause["at the recorder"] = recorded.foreign
    budgets = preparation.scenario.scenario.answers
    return replace(
        document,
        cycles=recorded.cycles,
        dropped=by_cause,
        recording_ended=recorded.ended_early or fault,
        wrong=_wrong_messages(plan, recorded),
        figures=run_figures(series) if series else None,
        plants=tuple(plant_figures(series)) if series else (),
        messages=_messages(
            plan, recorded, external, published, {} if is_complete else gaps, _by_signal(gaps)
        ),
        external=tuple(_compared(plan, path, account) for account in external),
        recording=overview,
        answers=judged(answers(series), budgets) if series else (),
        highlights=highlights(series) if series else None,
    )


def process_account(process: Process) -> ProcessAccount:
    finished = process.finished or Finished({}, [])
    return ProcessAccount(
        process.name,
        process.kind,
        _by_cause(finished.dropped),
        process.exited.resident_mb if process.exited else 0.0,
        (process.recorded or finished).own_mb,
        skipped_cycles=finished.skipped_cycles,
        cpu_s=process.cpu_in_run_s(),
    )


def _by_cause(dropped: Dropped) -> dict[str, int]:
    counts: Counter[str] = Counter()
    for _, cause, number in dropped:
        counts[cause] += number
    return dict(counts)


def _read(
    preparation: Preparation, folder: Path, recorded: Recorded
) -> tuple[Overview | None, Gaps, RunSeries | None, str]:
    """Read the recording; return also what is wrong with it in a line, empty if all is well."""
    plan, series = preparation.plan, None
    collector = SeriesCollector(plan, columns_of(plan))
    # After a recording that ended early there is no gap, and an external plant alone knows.
    is_known = not recorded.ended_early and PLANT not in plan.elsewhere
    try:
        with RunReader(folder) as run:
            overview, gaps = read_through(run, collector, is_known * recorded.cycles)
            if recorded.cycles:
                with suppress(InputError):  # It has no complete cycle.
                    series = collected(collector, run)
    except (InputError, OSError) as error:
        return None, {}, None, f"the recording cannot be read: {error}"
    found, reported = _by_signal(gaps), Counter(recorded.recorded)
    if reported - found:
        of = f"{found.total():,} of {reported.total():,} messages that were recorded"
        return overview, gaps, series, f"{overview.path}: it holds {of}"
    return overview, gaps, series, ""


def _by_signal(gaps: Gaps) -> Counter[str]:
    counts: Counter[str] = Counter()
    for port, one in gaps.items():
        counts[port.signal.name] += one.messages
    return +counts


def external_account(plan: RunPlan, agent: str, cycles: int, gaps: Gaps) -> ExternalAccount:
    own = {port: one for port, one in gaps.items() if port.publisher == agent}
    due = {port: -(-cycles // step) for port in own if (step := due_step(plan, port))}
    return ExternalAccount(
        agent,
        recorded=dict(_by_signal(own)),
        lost=sum(one.lost for one in own.values()),
        expected=sum(due.values()),
        answered=sum(own[port].cycles(cycles) for port in due),
    )


def _compared(plan: RunPlan, folder: Path, account: ExternalAccount) -> ExternalAccount:
    """Return the account of an external agent with its timing, and with what differs."""
    if plan.faults.device:
        return account
    agent = account.agent
    with suppress(InputError):  # There may be nothing to measure, or to compare.
        if not plan.timing.lockstep and agent != PLANT:
            with RunReader(folder) as reader:
                timings = devices_of(stage_table(reader, ()), plan)
            for found in (one for one in timings if one.agent == agent):
                wrong = found.findings if found.is_wrong else ()
                account = replace(account, late=found.late, findings=wrong)
    with suppress(InputError):
        if agent in plan.tree.leaves:
            result = verify(folder, agent).agents[agent]
            if (count := result.differences["differs"]) and result.first:
                text = (
                    f"{agent}: {count:,} messages differ from what it must decide, the first: "
                    f"{result.first.message} of cycle {result.first.cycle}, see heliarch verify "
                    f"{folder}"
                )
                account = replace(account, findings=(*account.findings, text))
    return account


def _messages(
    plan: RunPlan,
    recorded: Recorded,
    external: list[ExternalAccount],
    published: Counter[str],
    gaps: Gaps,
    heard: Counter[str],
) -> tuple[MessageCount, ...]:
    """Return what Heliarch's processes published, and what of that is recorded.

    gaps: What a process that died had published is unknown: the sequence numbers of the recorded
        messages show the least that it can be.
    """
    for account in external:
        heard.subtract(account.recorded)
    heard.subtract(recorded.extra)  # Of strangers, on keys of the processes.
    # A recording that had to end early may hold less than was heard.
    heard = Counter({signal: max(count, 0) for signal, count in heard.items()})
    if gaps:
        numbered = Counter(heard)
        for port, one in gaps.items():
            if port.publisher not in plan.elsewhere:
                numbered[port.signal.name] += one.lost
        published = numbered | published
    return tuple(
        MessageCount(signal, published[signal], heard[signal])
        for signal in dict.fromkeys([*published, *heard])
    )


def _wrong_messages(plan: RunPlan, recorded: Recorded) -> tuple[WrongMessages, ...]:
    """Return the wrong messages that the recorder names, the most frequent first."""
    publishers = {plan.wiring.key(port): port.publisher for port in plan.wiring.ports}
    wrong = [
        WrongMessages(
            one.key.removeprefix(f"{plan.plant}/"),
            one.cause,
            one.count,
            one.example,
            publishers.get(one.key, ""),
        )
        for one in recorded.complaints
    ]
    return tuple(sorted(wrong, key=lambda one: -one.count))
