"""Counts a finished recording, so that the end of a run says only what its file holds."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from agents.plan import RunPlan
from agents.process.events import ExternalAccount, Recorded
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import PRODUCTION, Port
from recordings.read.gaps import PortGaps, due_step, gaps_of_ports
from recordings.read.reader import RunReader


class RecordingCount(NamedTuple):
    """Messages by port, with gaps in those of external agents and productions, and the time."""

    gaps: dict[Port[Message], PortGaps]
    wall_ns: int = 0

    def by_signal(self, publisher: str | None = None) -> Counter[str]:
        """Return the messages of each signal, of one publisher or of all."""
        counts: Counter[str] = Counter()
        for port, gaps in self.gaps.items():
            if publisher in {None, port.publisher}:
                counts[port.signal.name] += gaps.messages
        return +counts


def count_messages(recording: Path) -> RecordingCount:
    """Count what a recording holds, with its further files.

    Every chunk is unpacked, but of most messages not even the head is decoded: about a million
    messages a second. InputError: there is no such file, or it cannot be read.
    """
    with RunReader(recording) as run:
        gaps, counts, first_ns, last_ns = gaps_of_ports(run.plan), Counter[int](), 0, 0
        read = {
            channel: port
            for channel, port in run.channels.items()
            if port.publisher in run.plan.elsewhere or port.signal is PRODUCTION
        }
        for chunk in run.followed_chunks():
            for channel, _, last_ns, _, _ in run.messages_of(chunk, run.channels):
                counts[channel] += 1
                first_ns = first_ns or last_ns
            for record in run.records_of(chunk, read):
                gaps[record.port].see(record.cycle, record.sequence, record.incarnation)
        for channel, count in counts.items():
            gaps[run.channels[channel]].messages = count
    return RecordingCount(gaps, last_ns - first_ns)


def checked(
    recording: Path, plan: RunPlan, account: Recorded
) -> tuple[Recorded, RecordingCount | None, str]:
    """Return a recorder's account with the counts of its recording, these, and what is wrong.

    That is in one line, empty if all is well: the recording is missing, cannot be read, or holds
    less than the recorder said.
    """
    try:
        count = count_messages(recording)
    except (InputError, OSError) as error:
        return replace(account, recorded={}), None, f"the recording cannot be read: {error}"
    recorded = count.by_signal()
    external = tuple(_external(plan, agent, account.cycles, count) for agent in plan.elsewhere)
    fault = ""
    if Counter(account.recorded) - recorded:
        reported = sum(account.recorded.values())
        held = f"{recorded.total():,} of {reported:,} messages that were recorded"
        fault = f"{recording}: it holds {held}"
    return replace(account, recorded=dict(recorded), external=external), count, fault


def _external(plan: RunPlan, agent: str, cycles: int, count: RecordingCount) -> ExternalAccount:
    own = {port: one for port, one in count.gaps.items() if port.publisher == agent}
    due = {port: -(-cycles // step) for port in own if (step := due_step(plan, port))}
    return ExternalAccount(
        agent,
        recorded=dict(count.by_signal(agent)),
        lost=sum(one.lost for one in own.values()),
        expected=sum(due.values()),
        answered=sum(own[port].cycles(cycles) for port in due),
    )
