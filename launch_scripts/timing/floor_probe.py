"""One probe of the machine's floor as a process: a bare timer loop, or a bare Zenoh round trip.

`python -m launch_scripts.timing.floor_probe SETTINGS`, where the settings are `ProbeSettings` as
JSON. It says `Prepared`, waits for the word `begin`, measures, and says `Probed`.
"""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections.abc import Callable
from typing import Final, Literal

import msgspec
import zenoh

from agents.events import Event
from agents.histograms import Extremes, extremes_of, new_histogram, record_ns
from agents.lifeline import Lifeline
from agents.machine import MachineSettings, take_machine
from agents.process_setup import join_run
from bus_schemas.zenoh_bus import SessionSettings

PAYLOAD: Final = bytes(20)
"""About as much as a message of the plant carries besides its head."""

_PING: Final = "floor/ping"
_PONG: Final = "floor/pong"
_LEAD_S: Final = 0.05
_SLEEP_S: Final = 0.1
_LONGEST_S: Final = 1.0
"""How long a ping is waited for before it counts as lost."""


class ProbeSettings(msgspec.Struct, frozen=True):
    """What a probe does.

    Attributes
    ----------
    role
        `timer`: wakes at the rate of the plant. `ping`: sends a message at that rate and waits for
        its return. `echo`: returns them.
    period_ns
        Length of a cycle.
    namespace, tcp_port
        Where ping and echo meet.
    machine
        What it takes of the machine: the same as a controller of the run.
    """

    role: Literal["timer", "ping", "echo"]
    period_ns: int
    namespace: str = ""
    tcp_port: int = 0
    machine: MachineSettings = MachineSettings()


class Prepared(Event, frozen=True):
    """The probe can begin."""


class Probed(Event, frozen=True):
    """What a probe measured: a histogram as text, and how many pings did not return."""

    histogram: str
    lost: int = 0
    extremes: Extremes | None = None


class Probe:
    """What the roles have in common: when to begin, when to end, and the periods in between.

    Parameters
    ----------
    period_ns
        Length of a period.
    now_ns, sleep
        The monotonic clock, and what waits for so many seconds of it.
    """

    def __init__(
        self,
        period_ns: int,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period_ns = period_ns
        self._now_ns = now_ns
        self._sleep = sleep
        self._begun = threading.Event()
        self._stopped = threading.Event()
        self._until_ns = 0

    def hear(self, word: str) -> None:
        """Heed a word of the parent: `begin SECONDS` or `stop`."""
        if word.startswith("begin"):
            self._until_ns = self._now_ns() + round(float(word.split()[1]) * 1e9)
            self._begun.set()
        else:
            self._stopped.set()
            self._begun.set()

    def await_begin(self) -> None:
        """Wait for the word."""
        self._begun.wait()

    @property
    def stopped(self) -> bool:
        """Whether the parent has said so."""
        return self._stopped.is_set()

    def on_each_period(self, act: Callable[[int], None]) -> None:
        """Call a function at the scheduled time of each period, which it is given, to the end."""
        due_ns = self._now_ns() + round(_LEAD_S * 1e9)
        while due_ns <= self._until_ns and not self.stopped:
            # Only the last part is slept through: a long period must not delay the end.
            if self._stopped.wait((due_ns - self._now_ns()) / 1e9 - _SLEEP_S):
                return
            left_ns = due_ns - self._now_ns()
            if left_ns > 0:
                self._sleep(left_ns / 1e9)
            act(due_ns)
            due_ns += self._period_ns


def run_timer(probe: Probe, lifeline: Lifeline) -> None:
    """Measure how late this machine wakes a process that does nothing else."""
    histogram = new_histogram()
    lifeline.tell(Prepared())
    probe.await_begin()
    probe.on_each_period(lambda due_ns: record_ns(histogram, time.monotonic_ns() - due_ns))
    lifeline.tell(Probed(histogram.encode().decode("ascii"), extremes=extremes_of(histogram)))


def run_echo(probe: Probe, settings: ProbeSettings, lifeline: Lifeline) -> None:
    """Return each message at once."""
    arrived: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    endpoint = [f"tcp/127.0.0.1:{settings.tcp_port}"]
    with zenoh.open(_session(settings, listen=endpoint, connect=[])) as session:
        pong = _publisher(session, _PONG)
        subscriber = session.declare_subscriber(_PING, arrived.put)
        lifeline.tell(Prepared())
        while not probe.stopped:
            try:
                pong.put(arrived.get(timeout=0.1).payload)
            except queue.Empty:
                continue
        subscriber.undeclare()


def run_ping(probe: Probe, settings: ProbeSettings, lifeline: Lifeline) -> None:
    """Measure how long a message takes there and back."""
    endpoint = [f"tcp/127.0.0.1:{settings.tcp_port}"]
    with zenoh.open(_session(settings, listen=[], connect=endpoint)) as session:
        pinger = Pinger(session)
        while not pinger.round_trip(0.1) and not probe.stopped:
            pass
        lifeline.tell(Prepared())
        probe.await_begin()
        probe.on_each_period(pinger.measure)
        found = pinger.histogram
        lifeline.tell(Probed(found.encode().decode("ascii"), pinger.lost, extremes_of(found)))


class Pinger:
    """Sends messages and awaits their return.

    Attributes
    ----------
    histogram
        Of the round trips.
    lost
        How many messages did not return.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self.histogram = new_histogram()
        self.lost = 0
        self._returned: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
        self._ping = _publisher(session, _PING)
        self._subscriber = session.declare_subscriber(_PONG, self._returned.put)
        self._last_end_ns = 0

    def round_trip(self, timeout_s: float) -> bool:
        """Send a message; return whether it came back."""
        while not self._returned.empty():
            self._returned.get()  # of a message that was given up
        self._ping.put(PAYLOAD)
        try:
            self._returned.get(timeout=timeout_s)
        except queue.Empty:
            return False
        return True

    def measure(self, due_ns: int) -> None:
        """Send the message of a period.

        One that had to wait for the return of the last counts from its scheduled time.
        """
        began_ns = due_ns if self._last_end_ns > due_ns else time.monotonic_ns()
        if self.round_trip(_LONGEST_S):
            self._last_end_ns = time.monotonic_ns()
            record_ns(self.histogram, self._last_end_ns - began_ns)
        else:
            self.lost += 1


def _session(settings: ProbeSettings, listen: list[str], connect: list[str]) -> zenoh.Config:
    return SessionSettings(settings.namespace, listen, connect, lockstep=False).config()


def _publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        reliability=zenoh.Reliability.RELIABLE,
    )


def main() -> int:
    """Run the probe that the command line describes. Returns the exit status."""
    settings = msgspec.json.decode(sys.argv[1], type=ProbeSettings)
    join_run(attached=True)
    take_machine(settings.machine, "direct", lockstep=False)
    probe = Probe(settings.period_ns)
    # The parent closes the line once it has said that this is the end.
    lifeline = Lifeline(attached=True, on_word=probe.hear, on_orphaned=lambda: probe.hear("stop"))
    match settings.role:
        case "timer":
            run_timer(probe, lifeline)
        case "echo":
            run_echo(probe, settings, lifeline)
        case "ping":
            run_ping(probe, settings, lifeline)
    return 0


if __name__ == "__main__":
    sys.exit(main())
