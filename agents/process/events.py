"""What the processes of a run tell their launcher, and what it asks of their fork server."""

from __future__ import annotations

from typing import TypeAlias

import msgspec


class Event(msgspec.Struct, frozen=True, tag_field="event", tag=str.lower):
    """News of a process for its launcher."""


class Joined(Event, frozen=True):
    """The process is on the bus."""


class Armed(Event, frozen=True):
    """All are there; cycle 0 begins at `start_time_ns` of the host's monotonic clock."""

    start_time_ns: int


class Waiting(Event, frozen=True):
    """The process cannot go on: it needs these messages, each `(key, publisher)`."""

    cycle: int
    stage: str
    needs: list[tuple[str, str]]


class Status(Event, frozen=True):
    """What the recorder has seen so far, for a live view. Powers in kW.

    unheard: Keys on which external agents were silent in an arming round.
    never_heard: Some agents that were silent in all of them, and their number.
    not_recorded: In real time: agents that the recorder has not heard for a while.
    not_heard: In real time: processes that none of their listeners hears.
    """

    cycle: int
    sim_time_ns: int
    dispatch_kw: float
    available_kw: float
    delivered_kw: float
    needy: list[str]
    recorded: int
    unheard: list[str] = []
    never_heard: tuple[list[str], int] = ([], 0)
    not_recorded: list[str] = []
    not_heard: list[str] = []


class Finished(Event, frozen=True):
    """The agent has come to the end of the run, or was dismissed by SIGTERM.

    `published` counts its messages by signal; `dropped` are port, cause and number. `own_mb` is the
    memory that it shares with no other process.
    """

    published: dict[str, int]
    dropped: list[tuple[str, str, int]]
    skipped_cycles: int = 0
    dismissed: bool = False
    own_mb: float = 0.0


class Started(Event, frozen=True):
    """The fork server has started a process; the launcher's end of the link comes with this."""

    agent: str
    pid: int


class Exited(Event, frozen=True):
    """A process has ended: its status (below 0: the signal), processor time, largest memory."""

    agent: str
    status: int
    cpu_s: float
    resident_mb: float = 0.0


class Presence(Event, frozen=True):
    """The token of an external agent has come or gone in this cycle, -1 before the run."""

    agent: str
    alive: bool
    cycle: int


class Over(Event, frozen=True):
    """An external plant has said that the run is over, before this cycle."""

    cycle: int


class Remark(Event, frozen=True):
    """A line for the user."""

    text: str


class Complaint(Event, frozen=True):
    """What was wrong with messages on a key (without the run's namespace), and the first one."""

    key: str
    cause: str
    count: int
    example: str


class Recorded(Event, frozen=True):
    """The recorder has closed its file.

    recorded: Messages in its file, by signal; a recorder before it has another file.
    foreign: Payloads on the run's keys that are no messages of the run.
    cycles: How many cycles the plant completed.
    ended_early: Why the file does not go up to the end of the run; empty if it does.
    complaints: What was wrong with foreign messages, those of external agents, and those that
        contradict others of their key.
    extra: Messages of `recorded` that came second on keys of the launcher's own processes.
    """

    recorded: dict[str, int]
    foreign: int
    cycles: int
    ended_early: str = ""
    complaints: tuple[Complaint, ...] = ()
    extra: dict[str, int] = {}
    own_mb: float = 0.0


class Failed(Event, frozen=True):
    """The process gives up, and why, in one line."""

    text: str


class Start(msgspec.Struct, frozen=True, tag=True):
    """Start a process.

    `plan` is a path, `logs` a folder. `earlier`: How many processes the agent had before this one.
    `again`: it joins a run that is under way.
    """

    plan: str
    logs: str
    agent: str
    earlier: int = 0
    again: bool = False


class SendSignal(msgspec.Struct, frozen=True, tag=True):
    """Send a signal to a process if it has not ended."""

    agent: str
    number: int


Request: TypeAlias = Start | SendSignal
