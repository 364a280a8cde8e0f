"""Writes a run as an MCAP file: each message as it was on the wire, with its schema.

Log and publish times are nanoseconds of the wall clock. They follow from the host's monotonic
clock by one pair of readings, kept in the metadata, so they never jump with the wall clock.
"""

from __future__ import annotations

import json
import os
import platform
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final

from mcap.writer import Writer

from agents.plan import RunPlan
from bus_schemas.code_digest import code_digest
from bus_schemas.codec import json_schema
from bus_schemas.errors import InputError
from bus_schemas.messages import Head, Message
from bus_schemas.signals import SIGNALS, Port, Signal
from recordings.read.mcap_file import GOES_ON
from recordings.read.run_file import RECORDING_NAME, SCHEMA_VERSION, next_path, recorded_ports
from recordings.record.chunk_writer import ChunkWriter
from recordings.record.time_service import clock_statement

_UNWRITABLE: Final = (OSError, struct.error, ValueError, OverflowError, MemoryError)
"""What writing a message can raise."""

_VERSIONED: Final = ("heliarch", "eclipse-zenoh", "msgspec", "mcap", "numpy", "pvlib")


@dataclass(frozen=True, slots=True)
class ClockAnchor:
    """One reading of both clocks at the same moment [ns]."""

    monotonic_ns: int
    wall_ns: int

    @classmethod
    def now(cls) -> ClockAnchor:
        return cls(time.monotonic_ns(), time.time_ns())

    @classmethod
    def of(cls, metadata: Mapping[str, Mapping[str, str]], path: Path) -> ClockAnchor:
        anchor = metadata.get("clock_anchor", {})
        try:
            return cls(int(anchor["monotonic_ns"]), int(anchor["wall_ns"]))
        except (KeyError, ValueError):
            raise InputError(
                f"{path}: metadata clock_anchor: expected monotonic_ns and wall_ns, got "
                f"{dict(anchor)}"
            ) from None

    def wall(self, monotonic_ns: int) -> int:
        return monotonic_ns - self.monotonic_ns + self.wall_ns


class RunWriter:
    """A recording that is being written.

    A failed write, as on a full disk, ends the recording, not the run: later messages are
    counted and not kept. Then `ended_early` says why, and `on_end` is called with it (None: the
    error is raised instead).

    `driver` is `launch` or `simulate`; the anchor turns times of the messages' clock into wall
    clock. `heard` counts the messages that should have been written.
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
        self.heard = 0
        self.ended_early = ""
        self._on_end = on_end
        self._cycle = 0
        self._anchor = anchor or ClockAnchor.now()
        self._to_wall_ns = self._anchor.wall(0)
        self._origin = plan, scenario, driver
        self._in_earlier_files: Counter[int] = Counter()
        self._begin_file(path, {})

    def _begin_file(self, path: Path, recorded: Mapping[int, int], **run: str) -> None:
        """Begin a file; `recorded` counts by channel what the one before it holds."""
        self._file = path.open("xb")
        self.path, self._first_cycle = path, self._cycle
        self._in_earlier_files.update(recorded)
        self._writer = ChunkWriter(self._file, "heliarch", f"heliarch {version('heliarch')}")
        plan, scenario, driver = self._origin
        self._write_origin(plan, scenario, driver, run)
        self._channels = declare(self._writer, plan, recorded_ports(plan))
        self._unless_ended(self._file.flush)  # A recorder that is killed at once leaves its plan.
        self._begun_at = self._file.tell()

    def add(
        self, port: Port[Message], head: Head | Message, payload: bytes, logged_ns: int
    ) -> None:
        if not self.heard:  # A recorder that was started again begins amid the run.
            self._first_cycle = head.cycle
        self.heard += 1
        self._cycle = head.cycle
        if self.ended_early:
            return
        channel, to_wall_ns = self._channels[port], self._to_wall_ns
        published_ns = head.publish_time_ns + to_wall_ns
        try:
            self._writer.add_message(
                channel, logged_ns + to_wall_ns, payload, published_ns, head.sequence
            )
        except _UNWRITABLE as error:
            self._end(error)

    @property
    def number_recorded(self) -> int:
        return self._in_earlier_files.total() + self._writer.recorded.total()

    @property
    def recorded(self) -> Counter[str]:
        counts: Counter[str] = Counter()
        for port, channel in self._channels.items():
            counts[port.signal.name] += (
                self._in_earlier_files[channel] + self._writer.recorded[channel]
            )
        return +counts

    def flush(self) -> None:
        """Hand all messages to the operating system, so that a crash does not lose them."""
        self._unless_ended(self._writer.flush)
        if not self.ended_early and self._is_full():
            self._unless_ended(self._go_on_in_next_file)

    def _is_full(self) -> bool:
        split = self._origin[0].supervision
        by_time = split.file_cycles and self._cycle >= self._first_cycle + split.file_cycles
        size = self._file.tell() - self._begun_at  # Without plan and schemas, which each file has.
        return bool(by_time or (split.file_bytes and size >= split.file_bytes))

    def _go_on_in_next_file(self) -> None:
        self._writer.add_metadata(GOES_ON, {})
        self._writer.finish()
        self._file.close()
        first = self.path.with_name(RECORDING_NAME)
        self._begin_file(next_path(first), self._writer.recorded, **{GOES_ON: "true"})

    def close(self) -> None:
        self._unless_ended(self._writer.finish)
        self._unless_ended(self._file.close)

    def abandon(self) -> None:
        with suppress(*_UNWRITABLE):  # The library tries the failed write again.
            self._file.close()

    def _unless_ended(self, act: Callable[[], None]) -> None:
        if not self.ended_early:
            try:
                act()
            except _UNWRITABLE as error:
                self._end(error)

    def _end(self, error: Exception) -> None:
        self.abandon()
        if self._on_end is None:
            raise error
        why = (isinstance(error, OSError) and error.strerror) or str(error)
        self.ended_early = f"the recording ended in cycle {self._cycle:,}: {self.path}: {why}"
        self._on_end(self.ended_early)

    def _write_origin(
        self, plan: RunPlan, scenario: str, driver: str, further: dict[str, str]
    ) -> None:
        anchor, add = self._anchor, self._writer.add_attachment
        times_ns = anchor.wall_ns, anchor.wall_ns
        add(*times_ns, "scenario.toml", "application/toml", scenario.encode())
        add(*times_ns, "plan.json", "application/json", plan.public.as_json())
        run = {
            "run_id": plan.run_id,
            "plant": plan.plant,
            "driver": driver,
            "schema_version": SCHEMA_VERSION,
            **further,
        }
        if driver == "launch":  # The timing of a run depends on the host.
            run |= {"host": platform.node(), "kernel": platform.release()}
            run |= {"cpu_count": str(os.cpu_count()), "time_service": clock_statement()}
        run |= {"python": platform.python_version(), "code": code_digest()}
        run |= {f"version {name}": version(name) for name in _VERSIONED}
        self._writer.add_metadata("run", run)
        clocks = {"monotonic_ns": str(anchor.monotonic_ns), "wall_ns": str(anchor.wall_ns)}
        self._writer.add_metadata("clock_anchor", clocks)


def declare(
    writer: ChunkWriter | Writer,
    plan: RunPlan,
    ports: Iterable[Port[Message]],
    schema: Callable[[Signal[Message]], object] = json_schema,
    encoding: str = "msgpack",
) -> dict[Port[Message], int]:
    """Declare the schema of each signal and the channel of each port; return the channels."""
    schema_of = {
        signal: writer.register_schema(
            signal.type.__name__, "jsonschema", json.dumps(schema(signal)).encode()
        )
        for signal in SIGNALS
        if signal.logged
    }
    return {
        port: writer.register_channel(
            plan.wiring.key(port),
            encoding,
            schema_of[port.signal],
            {"signal": port.signal.name, "node": port.node},
        )
        for port in ports
        if port.signal.logged
    }
