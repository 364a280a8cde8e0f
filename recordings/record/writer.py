"""Writes a run as an MCAP file: each message as it was on the wire, with its schema.

Log and publish times are nanoseconds of the wall clock, derived from the host's monotonic clock
by one pair of readings that the file's metadata keeps. So they never jump with the wall clock.
"""

from __future__ import annotations

import os
import platform
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final, Protocol

from mcap.writer import CompressionType, Writer

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Port, ports
from recordings.read.run_file import SCHEMA_VERSION, channels, schemas

_VERSIONED: Final = ("heliarch", "eclipse-zenoh", "msgspec", "mcap", "numpy", "pvlib")


def _machine() -> dict[str, str]:
    """Return what the timing of a run depends on."""
    return {
        "host": platform.node(),
        "kernel": platform.release(),
        "cpu_count": str(os.cpu_count()),
    }


@dataclass(frozen=True, slots=True)
class ClockAnchor:
    """One reading of both clocks at the same moment [ns]."""

    monotonic_ns: int
    wall_ns: int

    @classmethod
    def now(cls) -> ClockAnchor:
        """Read both clocks."""
        return cls(time.monotonic_ns(), time.time_ns())

    def wall(self, monotonic_ns: int) -> int:
        """Wall time of a monotonic time."""
        return monotonic_ns - self.monotonic_ns + self.wall_ns


class Numbered(Protocol):
    """What a recording must know of a message besides its bytes."""

    cycle: int
    publish_time_ns: int
    sequence: int


class RunWriter:
    """A recording that is being written.

    Parameters
    ----------
    path
        File to write.
    plan
        Of the run: gives the channels.
    scenario
        Text of the scenario file, attached whole.
    driver
        `launch` or `simulate`.
    anchor
        What the messages' clock has to do with the wall clock. Default: it is this host's
        monotonic clock.

    Raises
    ------
    FileExistsError
        There is a recording already: it is not replaced.

    Attributes
    ----------
    path
        The file.
    recorded
        Messages that were added, by signal.
    """

    def __init__(
        self,
        path: Path,
        plan: RunPlan,
        scenario: str,
        driver: str,
        anchor: ClockAnchor | None = None,
    ) -> None:
        self.path = path
        self.recorded: Counter[str] = Counter()
        self._anchor = anchor or ClockAnchor.now()
        self._file = path.open("xb")
        self._writer = Writer(self._file, compression=CompressionType.LZ4)
        self._writer.start(profile="heliarch", library=f"heliarch {version('heliarch')}")
        self._write_origin(plan, scenario, driver)
        self._channels = self._register(plan)

    def add(self, port: Port[Message], head: Numbered, payload: bytes, logged_ns: int) -> None:
        """Write one message.

        Parameters
        ----------
        port, head, payload
            Its port, its publish time and number, and itself as it was on the wire.
        logged_ns
            Monotonic time at which it was received.
        """
        self._writer.add_message(
            channel_id=self._channels[port],
            log_time=self._anchor.wall(logged_ns),
            publish_time=self._anchor.wall(head.publish_time_ns),
            sequence=head.sequence,
            data=payload,
        )
        self.recorded[port.signal.name] += 1

    def flush(self) -> None:
        """Hand all that was added to the operating system, so that a crash does not lose it."""
        self._writer.flush()

    def close(self) -> None:
        """Write the index and close the file."""
        self._writer.finish()
        self._file.close()

    def abandon(self) -> None:
        """Close a file that cannot be written any more, as it is."""
        with suppress(OSError):  # It tries once more to write what it could not write before.
            self._file.close()

    def _write_origin(self, plan: RunPlan, scenario: str, driver: str) -> None:
        now_ns = self._anchor.wall_ns
        self._writer.add_attachment(
            now_ns, now_ns, "scenario.toml", "application/toml", scenario.encode()
        )
        self._writer.add_attachment(now_ns, now_ns, "plan.json", "application/json", plan.as_json())
        self._writer.add_metadata(
            "run",
            {
                "run_id": plan.run_id,
                "plant": plan.plant,
                "driver": driver,
                "schema_version": SCHEMA_VERSION,
                **(_machine() if driver == "launch" else {}),
                "python": platform.python_version(),
                **{f"version {name}": version(name) for name in _VERSIONED},
            },
        )
        self._writer.add_metadata(
            "clock_anchor",
            {
                "monotonic_ns": str(self._anchor.monotonic_ns),
                "wall_ns": str(self._anchor.wall_ns),
            },
        )

    def _register(self, plan: RunPlan) -> dict[Port[Message], int]:
        # The file gives them the same numbers, so a reader can do without what stands in it.
        for schema in schemas():
            self._writer.register_schema(schema.name, schema.encoding, schema.data)
        for channel in channels(plan):
            self._writer.register_channel(
                channel.topic, channel.message_encoding, channel.schema_id, channel.metadata
            )
        logged = (port for port in ports(plan.tree) if port.signal.logged)
        return {port: number for number, port in enumerate(logged, start=1)}
