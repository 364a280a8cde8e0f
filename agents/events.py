"""What the processes of a run tell their launcher."""

from __future__ import annotations

import msgspec


class Event(msgspec.Struct, frozen=True, tag_field="event", tag=str.lower):
    """Something that a process tells its launcher."""


class Joined(Event, frozen=True):
    """The process is on the bus."""


class Armed(Event, frozen=True):
    """The plant has seen everybody, and a whole round has closed.

    Cycle 0 begins at `start_time_ns` of the host's monotonic clock.
    """

    rounds: int
    start_time_ns: int


class Waiting(Event, frozen=True):
    """The process cannot go on: it needs these messages, each `(key, publisher)`."""

    cycle: int
    stage: str
    needs: list[tuple[str, str]]


class Status(Event, frozen=True):
    """What the recorder has seen so far: the run's state for a live view. Powers in kW.

    `unheard` are the keys on which external agents have said nothing in an arming round, `silent`
    the controllers that have said nothing for longer than they may between two cycles.
    """

    cycle: int
    sim_time_ns: int
    desired_kw: float
    possible_kw: float
    delivered_kw: float
    needy: list[str]
    recorded: int
    unheard: list[str] = msgspec.field(default_factory=list)
    silent: list[str] = msgspec.field(default_factory=list)


class Standing(Event, frozen=True):
    """The process is there, and nobody hears it here: it stands by, or is on another host."""


class TookOver(Event, frozen=True):
    """The standby has taken over in this cycle."""

    cycle: int


class Finished(Event, frozen=True):
    """The agent has come to the end of the run.

    published: Messages of the run that it published, by signal.
    dropped: Messages that it did not use: port, cause and number.
    skipped_cycles: Cycles that were over before the agent came to them.
    dismissed: Whether SIGTERM ended it before the run was over.
    """

    published: dict[str, int]
    dropped: list[tuple[str, str, int]]
    skipped_cycles: int = 0
    dismissed: bool = False


class Started(Event, frozen=True):
    """The fork server has started a process for an agent."""

    pid: int


class Exited(Event, frozen=True):
    """A process has ended: its exit status (below 0: the signal), and its total processor time."""

    status: int
    cpu_s: float


class Presence(Event, frozen=True):
    """The liveliness token of an external agent has come or gone, seen by the recorder.

    `cycle` is the newest cycle by then, -1 before the run.
    """

    agent: str
    alive: bool
    cycle: int


class Over(Event, frozen=True):
    """An external plant has said that the run is over, before this cycle."""

    cycle: int


class Complaint(Event, frozen=True):
    """What was wrong with messages on a key, seen by the recorder.

    key: The key on the bus, without the run's namespace.
    cause: In what way they were wrong.
    count: How many of them were.
    example: What is to be said of the first one.
    """

    key: str
    cause: str
    count: int
    example: str


class ExternalAccount(msgspec.Struct, frozen=True):
    """What the recorder heard of an external agent, which gives no account of itself.

    recorded: Its messages in the recording, by signal.
    lost: Its messages that their sequence numbers show to be missing.
    expected: How many messages it should have sent on the keys on which one comes in each cycle.
    answered: How many of them came.
    outages: Cycles in which it went away and came back; None: it did not.
    """

    agent: str
    recorded: dict[str, int]
    lost: int
    expected: int
    answered: int
    outages: tuple[tuple[int, int | None], ...] = ()


class Recorded(Event, frozen=True):
    """The recorder has closed its file.

    recorded: Messages in the file, by signal.
    foreign: Payloads on the run's keys that are no messages of the run.
    cycles: How many cycles the plant completed.
    ended_early: Why the file does not go up to the end of the run; empty if it does.
    external: An account of each external agent. Their messages are among the others in `recorded`.
    complaints: What was wrong with messages that are none of the run, with those of external
        agents, and with those that contradict others of their key.
    extra: Messages of `recorded` that came second on keys of the launcher's own processes, by
        signal.
    """

    recorded: dict[str, int]
    foreign: int
    cycles: int
    ended_early: str = ""
    external: tuple[ExternalAccount, ...] = ()
    complaints: tuple[Complaint, ...] = ()
    extra: dict[str, int] = msgspec.field(default_factory=dict)


class RecordingEnded(Event, frozen=True):
    """The recorder cannot write any more, and why, in one line. The run goes on without it."""

    text: str


class Failed(Event, frozen=True):
    """The process gives up, and why, in one line."""

    text: str
