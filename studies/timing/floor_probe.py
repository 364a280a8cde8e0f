"""One probe of the machine's floor as a process: a bare timer loop, or a bare Zenoh round trip.

`python -m studies.timing.floor_probe SETTINGS`, where the settings are `ProbeSettings` as
JSON. The word `begin SECONDS` on standard input lets it measure for so long, or until the next
word. At the end it writes `Probed` as JSON to standard output.
"""

from __future__ import annotations

import queue
import select
import sys
import time
from collections.abc import Callable, Iterator
from typing import Final, Literal

import msgspec
import zenoh

from agents.machine import MachineSettings, take_machine
from agents.process import die_with_parent
from bus_schemas.zenoh_bus import SessionSettings, open_session
from studies.timing.durations import Distribution, Durations

PAYLOAD: Final = bytes(20)
"""About as much as a message of the plant carries besides its head."""

_PING: Final = "floor/ping"
_PONG: Final = "floor/pong"
_LEAD_NS: Final = 50_000_000
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


class Probed(msgspec.Struct, frozen=True):
    """What a probe measured, and how many pings did not return."""

    times: Distribution | None
    lost: int = 0


def due_times(
    period_ns: int,
    until_ns: int,
    now_ns: Callable[[], int],
    stopped_within: Callable[[float], bool],
) -> Iterator[int]:
    """Yield the scheduled time of each period when it has come.

    Parameters
    ----------
    period_ns, until_ns
        Length of a period, and the time after which none begins.
    now_ns
        The clock.
    stopped_within
        Waits for so many seconds; returns at once and says so if the probe must end.
    """
    due_ns = now_ns() + _LEAD_NS
    while due_ns <= until_ns:
        if stopped_within(max(due_ns - now_ns(), 0) / 1e9):
            return
        yield due_ns
        due_ns += period_ns


def heard_within(seconds: float) -> bool:
    """Wait for a word of the parent; return whether it spoke, or is gone."""
    return bool(select.select([sys.stdin], [], [], seconds)[0])


def periods(settings: ProbeSettings) -> Iterator[int]:
    """Wait for the parent to let the probe begin; then yield the time of each period."""
    word, _, seconds = sys.stdin.readline().partition(" ")
    if word == "begin":
        until_ns = time.monotonic_ns() + round(float(seconds) * 1e9)
        yield from due_times(settings.period_ns, until_ns, time.monotonic_ns, heard_within)


def run_timer(settings: ProbeSettings) -> Probed:
    """Measure how late this machine wakes a process that does nothing else."""
    late = Durations()
    for due_ns in periods(settings):
        late.add(time.monotonic_ns() - due_ns)
    return Probed(late.distribution())


def run_echo(settings: ProbeSettings) -> Probed:
    """Return each message at once, until the parent ends this process."""
    endpoint = [f"tcp/127.0.0.1:{settings.tcp_port}"]
    with _session(settings, listen=endpoint, connect=[]) as session:
        pong = _publisher(session, _PONG)
        subscriber, arrived = _subscribe(session, _PING)
        while not heard_within(0.0):
            try:
                pong.put(arrived.get(timeout=_LONGEST_S).payload)
            except queue.Empty:
                continue
        subscriber.undeclare()
    return Probed(None)


def run_ping(settings: ProbeSettings) -> Probed:
    """Measure how long a message takes there and back.

    One that had to wait for the return of the last counts from its scheduled time.
    """
    endpoint = [f"tcp/127.0.0.1:{settings.tcp_port}"]
    with _session(settings, listen=[], connect=endpoint) as session:
        ping = _publisher(session, _PING)
        subscriber, returned = _subscribe(session, _PONG)

        def round_trip(timeout_s: float) -> bool:
            while not returned.empty():
                returned.get()  # of a message that was given up
            ping.put(PAYLOAD)
            try:
                returned.get(timeout=timeout_s)
            except queue.Empty:
                return False
            return True

        while not round_trip(0.1) and not heard_within(0.0):
            pass
        trips, lost, ended_ns = Durations(), 0, 0
        for due_ns in periods(settings):
            began_ns = due_ns if ended_ns > due_ns else time.monotonic_ns()
            if round_trip(_LONGEST_S):
                ended_ns = time.monotonic_ns()
                trips.add(ended_ns - began_ns)
            else:
                lost += 1
        subscriber.undeclare()
    return Probed(trips.distribution(), lost)


def _session(settings: ProbeSettings, listen: list[str], connect: list[str]) -> zenoh.Session:
    return open_session(SessionSettings(settings.namespace, listen, connect, lockstep=False))


def _publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        reliability=zenoh.Reliability.RELIABLE,
    )


def _subscribe(
    session: zenoh.Session, key: str
) -> tuple[zenoh.Subscriber[None], queue.SimpleQueue[zenoh.Sample]]:
    arrived: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    callback = zenoh.handlers.Callback(arrived.put, indirect=False)
    return session.declare_subscriber(key, callback), arrived


def main() -> int:
    """Run the probe that the command line describes. Returns the exit status."""
    settings = msgspec.json.decode(sys.argv[1], type=ProbeSettings)
    die_with_parent()
    take_machine(settings.machine, "direct", lockstep=False)
    run = {"timer": run_timer, "echo": run_echo, "ping": run_ping}[settings.role]
    probed = run(settings)
    sys.stdout.buffer.write(msgspec.json.encode(probed) + b"\n")
    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
