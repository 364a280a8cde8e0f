"""A recording as an MCAP file for Foxglove and Lichtblick: JSON messages with JSON Schemas."""

from __future__ import annotations

import json
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Final, Literal, TypeAlias

from mcap.writer import CompressionType, Writer

from bus_schemas.messages import Message
from bus_schemas.signals import SIGNALS, Port
from recordings.export.json_messages import json_bytes, object_schema
from recordings.read.reader import RecordedMessage, RunReader

Clock: TypeAlias = Literal["wall", "sim"]
"""Which time a viewer shows: the wall clock, or the simulated time of the cycle."""

EXPORT_METADATA: Final = "heliarch export"
"""Name of the metadata. Not that of a recording, which this file is not."""


class ViewerFile:
    """A file for viewers that is being written.

    Keys, schema names, attachments and sequence numbers are those of the recording.
    """

    def __init__(
        self, path: Path, reader: RunReader, ports: Iterable[Port[Message]], clock: Clock
    ) -> None:
        self._sim = clock == "sim"
        self._file = path.open("xb")
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"heliarch {version('heliarch')}")
        self._write_origin(reader, clock)
        schemas = {
            signal: self._writer.register_schema(
                signal.type.__name__, "jsonschema", json.dumps(object_schema(signal)).encode()
            )
            for signal in SIGNALS
            if signal.logged
        }
        self._channels = {
            port: self._writer.register_channel(
                reader.plan.wiring.key(port),
                "json",
                schemas[port.signal],
                {"signal": port.signal.name, "node": port.node},
            )
            for port in sorted(ports, key=str)
        }

    def add(self, record: RecordedMessage, message: Message) -> None:
        self._writer.add_message(
            channel_id=self._channels[record.port],
            log_time=message.sim_time_ns if self._sim else record.log_time_ns,
            publish_time=message.sim_time_ns if self._sim else record.publish_time_ns,
            sequence=record.sequence,
            data=json_bytes(message),
        )

    def __enter__(self) -> ViewerFile:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        with self._file:
            if kind is None:
                self._writer.finish()

    def _write_origin(self, reader: RunReader, clock: Clock) -> None:
        for entry in reader.outline.attachments:
            self._writer.add_attachment(
                entry.create_time, entry.log_time, entry.name, entry.media_type, entry.data
            )
        origin = {
            f"{name}.{key}": value
            for name, entries in reader.metadata.items()
            for key, value in entries.items()
        }
        self._writer.add_metadata(EXPORT_METADATA, {"clock": clock, **origin})
