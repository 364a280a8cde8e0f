"""Writes a run as an MCAP file: each message as it was on the wire, with its schema.

Log and publish times are nanoseconds of the wall clock. They are derived from the host's monotonic
clock by one pair of readings, which the metadata keeps, so they never jump with the wall clock.
"""

from __future__ import annotations

import os
import platform
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final, Protocol

import msgspec
from mcap.writer import CompressionType, Writer

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Port, ports
from recordings.read.reader import RunReader
from recordings.read.run_file import SCHEMA_VERSION, channels, schemas

_VERSIONED: Final = ("heliarch", "eclipse-zenoh", "msgspec", "mcap", "numpy", "pvlib")


def _machine() -> dict[str, str]:
    """Return the host that the timing of a run depends on."""
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

    @classmethod
    def of(cls, metadata: Mapping[str, Mapping[str, str]]) -> ClockAnchor:
        """Return the one that a recording keeps in its metadata; InputError if it has none."""
        found = metadata.get("clock_anchor", {})
        try:
            return cls(int(found["monotonic_ns"]), int(found["wall_ns"]))
        except (KeyError, ValueError):
            raise InputError(
                f"metadata clock_anchor: expected monotonic_ns and wall_ns, got {dict(found)}"
            ) from None

    def wall(self, monotonic_ns: int) -> int:
        """Return the wall time of a monotonic time."""
        return monotonic_ns - self.monotonic_ns + self.wall_ns


class Numbered(Protocol):
    """What a recording must know of a message besides its bytes."""

    cycle: int
    publish_time_ns: int
    sequence: int


class RunWriter:
    """A recording that is being written.

    A full disk ends the recording, not the run: later messages are counted and not kept. The file
    then ends as if it had been cut; it can be read up to there, and `heliarch recover` repairs it.

    Parameters
    ----------
    path
        File to write.
    plan
        The plan of the run, which gives the channels.
    scenario
        Text of the scenario file, attached whole.
    driver
        `launch` or `simulate`.
    anchor
        Turns times of the messages' clock into wall clock. By default that is this host's
        monotonic clock.
    on_end
        Called once, with a line of text, when the recording has to end early. None: the error is
        raised instead.

    Raises
    ------
    FileExistsError
        There is a recording already: it is not replaced.

    Attributes
    ----------
    path
        The file.
    heard
        Messages that should have been written.
    recorded
        Messages in the file, by signal. If the recording ended early, `close` counts them there.
    trouble
        Why the recording ended early; empty otherwise.
    """

    def __init__(
        self,
        path: Path,
        plan: RunPlan,
        scenario: str,
        driver: str,
        anchor: ClockAnchor | None = None,
        on_end: Callable[[str], None] | None = None,
    ) -> None:
        self.path = path
        self.heard = 0
        self.recorded: Counter[str] = Counter()
        self.trouble = ""
        self._on_end = on_end
        self._cycle = 0
        self._anchor = anchor or ClockAnchor.now()
        self._file = path.open("xb")
        self._writer = Writer(self._file, compression=CompressionType.LZ4)
        self._writer.start(profile="heliarch", library=f"heliarch {version('heliarch')}")
        self._write_origin(plan, scenario, driver)
        self._channels = self._register(plan)

    def add(self, port: Port[Message], head: Numbered, payload: bytes, logged_ns: int) -> None:
        """Write one message."""
        self.heard += 1
        self._cycle = head.cycle
        if self.trouble:
            return
        try:
            self._writer.add_message(
                channel_id=self._channels[port],
                log_time=self._anchor.wall(logged_ns),
                publish_time=self._anchor.wall(head.publish_time_ns),
                sequence=head.sequence,
                data=payload,
            )
        except OSError as error:
            self._end(error)
        else:
            self.recorded[port.signal.name] += 1

    def flush(self) -> None:
        """Hand all that was added to the operating system, so that a crash does not lose it."""
        if not self.trouble:
            try:
                self._writer.flush()
            except OSError as error:
                self._end(error)

    def close(self) -> None:
        """Write the index and close the file."""
        if not self.trouble:
            try:
                self._writer.finish()
                self._file.close()
            except OSError as error:
                self._end(error)
        if self.trouble:
            self.recorded = _count(self.path)

    def abandon(self) -> None:
        """Close a file that cannot be written any more, as it is."""
        with suppress(OSError):  # It tries once more to write what it could not write before.
            self._file.close()

    def _end(self, error: OSError) -> None:
        self.abandon()
        if self._on_end is None:
            raise error
        cycle, reason = self._cycle, error.strerror
        self.trouble = f"the recording ended in cycle {cycle:,}: {self.path}: {reason}"
        self._on_end(self.trouble)

    def _write_origin(self, plan: RunPlan, scenario: str, driver: str) -> None:
        now_ns = self._anchor.wall_ns
        public = msgspec.structs.replace(plan, secret="", users_file="", keys_folder="")
        self._writer.add_attachment(
            now_ns, now_ns, "scenario.toml", "application/toml", scenario.encode()
        )
        self._writer.add_attachment(
            now_ns, now_ns, "plan.json", "application/json", public.as_json()
        )
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
        # The file gives them the same numbers: a reader can do without its first chunk.
        for schema in schemas():
            self._writer.register_schema(schema.name, schema.encoding, schema.data)
        for channel in channels(plan):
            self._writer.register_channel(
                channel.topic, channel.message_encoding, channel.schema_id, channel.metadata
            )
        logged = (port for port in ports(plan.tree) if port.signal.logged)
        return {port: number for number, port in enumerate(logged, start=1)}


def _count(path: Path) -> Counter[str]:
    """Count the messages in a recording, by signal; none if it cannot be read."""
    try:
        with RunReader(path) as run:
            return Counter(record.port.signal.name for record in run.records())
    except InputError:
        return Counter()
