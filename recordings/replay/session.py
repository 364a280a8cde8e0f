"""The replay's place on the bus: recorded bytes out, for any subscriber that connects."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

import zenoh

from bus_schemas.bus import Outbox
from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.messages import Clock
from bus_schemas.signals import CLOCK
from bus_schemas.tree import REPLAYER, ROOT
from bus_schemas.zenoh_bus import ENCODING, SessionSettings
from launch_scripts.launcher.interruption import Interruption
from launch_scripts.launcher.tcp_ports import reserved_ports
from recordings.replay.recorded_run import RecordedRun
from recordings.replay.selection import Selection


class ReplaySession:
    """Publishes payloads as they are.

    A subscriber that falls behind holds the replay up: nothing is dropped.

    Parameters
    ----------
    namespace
        Prefix of every key.
    endpoint
        Where subscribers connect, such as `tcp/127.0.0.1:7447`.
    keys
        Keys that payloads go out on.
    clock_key
        Key on which simulated time is announced; None: it is not.

    Raises
    ------
    InputError
        One cannot listen there, or the namespace can be no prefix of a key.
    """

    def __init__(
        self, namespace: str, endpoint: str, keys: Iterable[str], clock_key: str | None
    ) -> None:
        self._outbox = Outbox()
        try:
            zenoh.KeyExpr(namespace)
        except zenoh.ZError:
            raise InputError(
                f"--namespace {namespace!r}: accepted are names with / between, such as oahu-4711"
            ) from None
        try:
            self._session = zenoh.open(SessionSettings(namespace, [endpoint], []).config())
        except zenoh.ZError as error:
            reason = str(error).partition(" at /")[0]
            raise InputError(
                f"--listen {endpoint}: {reason}; accepted is a free address such as "
                "tcp/127.0.0.1:7447"
            ) from None
        self._publishers = {key: self._declare(key) for key in keys}
        self._put = {key: publisher.put for key, publisher in self._publishers.items()}
        self._clock = self._declare(clock_key) if clock_key is not None else None

    def put(self, key: str, payload: bytes) -> None:
        """Send bytes. Waits for a subscriber that has fallen behind."""
        self._put[key](payload)

    def announce(self, clock: Clock) -> None:
        """Tell everybody where the replay stands."""
        if self._clock is not None:
            self._outbox.stamp(CLOCK.of(ROOT), clock, time.monotonic_ns())
            self._clock.put(encode(clock))

    @property
    def has_subscriber(self) -> bool:
        """Whether anybody subscribes to any of the keys."""
        return any(_has_match(publisher) for publisher in self._publishers.values())

    def __enter__(self) -> ReplaySession:
        return self

    def __exit__(self, *error: object) -> None:
        # An open session can hang the interpreter's exit.
        self._session.close()

    def _declare(self, key: str) -> zenoh.Publisher:
        return self._session.declare_publisher(
            key,
            encoding=ENCODING,
            congestion_control=zenoh.CongestionControl.BLOCK,
            reliability=zenoh.Reliability.RELIABLE,
        )


def introduce(recorded: RecordedRun, out: TextIO) -> None:
    """Say which run is replayed."""
    out.write(f"{recorded.plan.run_id}, {recorded.clock.extent()}\n")
    if not recorded.whole:
        out.write("cut short: replayed up to the cut (`heliarch recover` makes a whole file)\n")
    out.flush()


@contextmanager
def replay_session(
    recorded: RecordedRun,
    selection: Selection,
    namespace: str | None,
    listen: str | None,
    out: TextIO,
) -> Iterator[ReplaySession]:
    """Join the bus and say how a subscriber does.

    Parameters
    ----------
    recorded, selection
        What is replayed.
    namespace
        First part of every key; by default that of the run.
    listen
        Endpoint for subscribers; by default a free port on 127.0.0.1.
    out
        Where it is said.

    Raises
    ------
    InputError
        See `ReplaySession`.
    """
    prefix = recorded.plan.run_id if namespace is None else namespace
    with reserved_ports((REPLAYER,)) as tcp_ports:
        endpoint = listen or f"tcp/127.0.0.1:{tcp_ports[REPLAYER]}"
        keys = selection.key_of.values()
        with ReplaySession(prefix, endpoint, keys, selection.clock_key) as session:
            out.write(f"endpoint {endpoint}\nkeys {prefix}/{recorded.plan.plant}/**\n")
            out.flush()
            yield session


def await_subscriber(session: ReplaySession, interruption: Interruption, out: TextIO) -> None:
    """Wait until somebody subscribes, or the user asks for an end."""
    out.write("waiting for a subscriber\n")
    out.flush()
    while not interruption and not session.has_subscriber:
        interruption.wait(0.05)


def _has_match(publisher: zenoh.Publisher) -> bool:
    status: Any = publisher.matching_status  # no bool, whatever its type stub says
    return bool(status.matching)
