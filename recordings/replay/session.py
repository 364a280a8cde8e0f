"""A replay's place on the bus: which ports it publishes, at which address, and for whom."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import TextIO

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import CLOCK, SIGNALS, Port
from bus_schemas.tree import REPLAYER, ROOT
from launch_scripts.launcher.interruption import Interruption
from launch_scripts.launcher.tcp_ports import reserved_ports
from recordings.read.reader import RunReader
from recordings.read.selection import find_signals
from recordings.replay.bus import ReplayBus


def selected_ports(
    plan: RunPlan, signals: str | None = None, exclude: str | None = None
) -> tuple[Port[Message], ...]:
    """Return the ports that are replayed: by default the recorded ones, and the replay's clock.

    Raises
    ------
    InputError
        There is no such signal, or none is left.
    """
    excluded = _names(exclude)
    left_out = {*find_signals(name for name in excluded if name != CLOCK.name)}
    kept = find_signals(_names(signals)) or tuple(signal for signal in SIGNALS if signal.logged)
    ports = [
        port for port in plan.keys.ports if port.signal in kept and port.signal not in left_out
    ]
    if not ports:
        raise InputError("--exclude: expected some signal to be left, got none")
    return tuple(ports) if CLOCK.name in excluded else (*ports, CLOCK.of(ROOT))


def introduce(reader: RunReader, out: TextIO) -> None:
    """Print which run is replayed."""
    say(out, f"{reader.plan.run_id}, {reader.clock.extent()}")
    if not reader.whole:
        say(out, "cut short: replayed up to the cut (`heliarch recover` makes a whole file)")


@contextmanager
def replay_bus(
    plan: RunPlan, ports: Collection[Port[Message]], listen: str | None, out: TextIO
) -> Iterator[ReplayBus]:
    """Join the bus, at an address or at a free port of 127.0.0.1; print how to subscribe."""
    with reserved_ports((REPLAYER,)) as tcp_ports:
        endpoint = listen or f"tcp/127.0.0.1:{tcp_ports[REPLAYER]}"
        with ReplayBus(plan, ports, endpoint) as bus:
            say(out, f"endpoint {endpoint}\nkeys {plan.run_id}/{plan.plant}/**")
            yield bus


def await_subscriber(bus: ReplayBus, interruption: Interruption, out: TextIO) -> None:
    """Wait until somebody subscribes, or the user asks for an end."""
    say(out, "waiting for a subscriber")
    while not interruption and not bus.has_subscriber:
        interruption.wait(0.05)


def say(out: TextIO, text: str) -> None:
    """Print a line at once."""
    out.write(f"{text}\n")
    out.flush()


def _names(text: str | None) -> list[str]:
    return [] if text is None else [name.strip() for name in text.split(",")]
