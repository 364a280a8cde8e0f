"""The line between a process of a run and the launcher that started it.

Events go out as lines of JSON on standard output; words come in on standard input. The line needs
no bus, so it works while the bus does not. When the launcher is gone, however it died, standard
input ends, and the process ends with it.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import TypeAlias

import msgspec

from agents.parent_death import on_parent_death
from agents.stopwatch import ProcessTiming

log = logging.getLogger(__name__)


class Event(msgspec.Struct, frozen=True, tag_field="event", tag=str.lower):
    """Something that a process tells its launcher."""


class Ready(Event, frozen=True):
    """The process is on the bus."""


class Armed(Event, frozen=True):
    """The plant has seen everybody, and a whole round has closed: cycle 0 begins."""

    rounds: int


class Waiting(Event, frozen=True):
    """The process cannot go on: it needs these messages, each `[key, publisher]`.

    `blocked_on` is the key that it cannot publish, because a listener takes nothing any more.
    """

    cycle: int
    stage: str
    needs: list[tuple[str, str]]
    blocked_on: str = ""


class Status(Event, frozen=True):
    """What the recorder has seen so far: the run's state for a live view. Powers in kW.

    `unheard` are the keys on which external agents have said nothing in an arming round.
    """

    cycle: int
    sim_time_ns: int
    desired_kw: float
    possible_kw: float
    delivered_kw: float
    needy: list[str]
    recorded: int
    unheard: list[str] = msgspec.field(default_factory=list)


class Finished(Event, frozen=True):
    """The process has come to its end.

    Attributes
    ----------
    published
        Messages of the run that it published, by signal.
    dropped
        Messages that it could not use, by cause.
    missing_inputs
        Inputs that a deadline found missing.
    late_used
        Late words that were used in place of them.
    skipped_cycles
        Cycles that were given up, since they were over before the process came to them.
    dropped_ports
        Messages that it could not use, by port and cause.
    timing
        What it measured of itself in real time; None in lockstep.
    faults
        What an imperfect network did to messages on their way to it.
    """

    published: dict[str, int]
    dropped: dict[str, int]
    missing_inputs: int
    late_used: int = 0
    skipped_cycles: int = 0
    dropped_ports: dict[str, dict[str, int]] = msgspec.field(default_factory=dict)
    timing: ProcessTiming | None = None
    faults: dict[str, int] = msgspec.field(default_factory=dict)


class PlantPower(msgspec.Struct, frozen=True):
    """The plant's power, cycle by cycle [kW].

    Attributes
    ----------
    desired_kw, regulation_kw
        What was asked of it in all, and the part of it that is regulation.
    possible_kw, delivered_kw
        What it could have given, and what it gave.
    """

    desired_kw: list[float] = msgspec.field(default_factory=list)
    regulation_kw: list[float] = msgspec.field(default_factory=list)
    possible_kw: list[float] = msgspec.field(default_factory=list)
    delivered_kw: list[float] = msgspec.field(default_factory=list)


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

    Attributes
    ----------
    key
        The key on the bus, without the run's namespace.
    cause
        In what way they were wrong.
    count
        How many of them were.
    example
        What is to be said of the first one.
    """

    key: str
    cause: str
    count: int
    example: str


class ExternalAccount(msgspec.Struct, frozen=True):
    """What the recorder heard of an external agent, which gives no account of itself.

    Attributes
    ----------
    recorded
        Its messages in the recording, by signal.
    lost
        Its messages that their sequence numbers show to be missing.
    expected
        How many messages it should have sent on the keys on which one comes in each cycle.
    answered
        How many of them came.
    """

    agent: str
    recorded: dict[str, int]
    lost: int
    expected: int
    answered: int


class Recorded(Event, frozen=True):
    """The recorder has closed its file.

    Attributes
    ----------
    recorded
        Messages in the file, by signal.
    gaps
        Messages that sequence numbers show to be missing, by signal.
    foreign
        Payloads on the run's keys that are no messages of the run.
    plant
        What the run came to.
    ended_early
        Why the file does not go up to the end of the run; empty if it does.
    external
        An account of each external agent. Their messages are among the others in `recorded`.
    complaints
        What was wrong with messages that are none of the run, and with those of external agents.
    """

    recorded: dict[str, int]
    gaps: dict[str, int]
    foreign: int
    plant: PlantPower
    ended_early: str = ""
    external: tuple[ExternalAccount, ...] = ()
    complaints: tuple[Complaint, ...] = ()


class RecordingEnded(Event, frozen=True):
    """The recorder cannot write any more, and why, in one line. The run goes on without it."""

    text: str


class Failed(Event, frozen=True):
    """The process gives up, and why, in one line."""

    text: str


AnyEvent: TypeAlias = (
    Ready
    | Armed
    | Waiting
    | Status
    | Finished
    | Presence
    | Over
    | Complaint
    | Recorded
    | RecordingEnded
    | Failed
)


def end_at_once() -> None:
    """End this process, whatever its other threads do; its last words are in its log."""
    logging.shutdown()
    os._exit(1)


class Lifeline:
    """A process's end of the line.

    Parameters
    ----------
    attached
        Whether a launcher holds the other end. Without one, events are printed all the same, and
        standard input is left alone: an agent can be run by hand.
    on_word
        Called, on a thread of its own, with each word that comes in.
    on_orphaned
        Called likewise when the launcher is gone.
    """

    def __init__(
        self,
        attached: bool,
        on_word: Callable[[str], None] = lambda word: None,
        on_orphaned: Callable[[], None] = end_at_once,
    ) -> None:
        self._encoder = msgspec.json.Encoder()
        self._lock = threading.Lock()
        self._on_word = on_word
        self._on_orphaned = on_orphaned
        if attached:
            threading.Thread(target=self._listen, name="lifeline", daemon=True).start()

    def tell(self, event: Event) -> None:
        """Send an event."""
        line = self._encoder.encode(event) + b"\n"
        with self._lock:
            try:
                sys.stdout.buffer.write(line)
                sys.stdout.buffer.flush()
            except BrokenPipeError:
                log.warning("nobody reads events any more")
                self._on_orphaned()

    def _listen(self) -> None:
        for line in sys.stdin:
            self._on_word(line.strip())
        log.warning("the launcher is gone")
        self._on_orphaned()


def join_run(attached: bool, death_signal: signal.Signals = signal.SIGKILL) -> None:
    """Set this process up as part of a run: its log, and what it does when its launcher dies.

    Standard input ends with the launcher; but a process that is blocked deep in a library, or
    stopped, would not see it. So the kernel is asked for a signal too, where it can (Linux).

    Parameters
    ----------
    attached
        Whether a launcher started it.
    death_signal
        Sent when the launcher dies.
    """
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
    # Ctrl-C in a terminal reaches every process of the group: the launcher decides, not we.
    if not attached:
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    on_parent_death(death_signal)
