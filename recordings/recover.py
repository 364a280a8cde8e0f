"""Makes a whole recording of a cut one: everything up to the cut, with a new index."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final, TypeAlias

import msgspec
from mcap.writer import CompressionType, Writer

from bus_schemas.codec import decode
from bus_schemas.signals import PRODUCTION, RUN
from recordings.read.chunks import (
    ChunkPlace,
    DamagedChunkError,
    RawMessage,
    messages_in,
    unpack_chunk,
)
from recordings.read.gaps import RunGaps
from recordings.read.outline import Outline
from recordings.read.reader import RunReader, cycle_of, head_of
from recordings.read.whole_file import new_path

RECOVERY_METADATA: Final = "recovery"
"""Name of the metadata of a recovered file."""


class DamagedChunk(msgspec.Struct, frozen=True):
    """A chunk that could not be read: where, when it was recorded (wall clock), and why."""

    offset: int
    first_ns: int
    last_ns: int
    reason: str


class Recovery(msgspec.Struct, frozen=True):
    """The result of a recovery.

    `closed`: the recorder had come to its end. `ended`: the recording goes up to the end of the
    run. `cut_bytes` at the end of the file make up no whole record; `cut_messages` could be read of
    them, and no checksum verifies those. `lost` messages are missing between others; on
    `early_ports`, `early_messages` were due up to the end of the run.
    """

    source: str
    out: str
    closed: bool
    ended: bool
    messages: int
    complete_cycles: int
    last_cycle: int
    planned_cycles: int
    last_ns: int
    cut_bytes: int
    cut_messages: int
    lost: int
    early_ports: int
    early_messages: int
    damaged: tuple[DamagedChunk, ...]
    damaged_attachments: tuple[str, ...]

    @property
    def lossless(self) -> bool:
        """Whether nothing that was recorded can be missing."""
        missing = self.lost or self.early_ports or self.damaged or self.damaged_attachments
        return (self.closed or self.ended) and not missing


_Follow: TypeAlias = Callable[[float], None]


def is_sound(run: RunReader, follow: _Follow = lambda share: None) -> bool:
    """Whether a recording was closed in order and all of it can be read.

    `follow` is called now and then with the share that has been read, 0 to 1.
    """
    if not run.whole or run.outline.damaged_attachments:
        return False
    for place in run.outline.chunks:
        follow(place.offset / run.outline.size)
        try:
            unpack_chunk(run.file, place)
        except DamagedChunkError:
            return False
    return True


def recover_run(run: RunReader, out: Path, follow: _Follow = lambda share: None) -> Recovery:
    """Copy everything that can be read of a recording into a new one.

    Attachments, metadata, schemas and channels are the same; so are the messages, byte for byte,
    with their times, sequence numbers and order. Metadata named `recovery` is added.
    """
    with new_path(out) as beside, beside.open("xb") as file:
        copy = _Copy(run, file)
        for place in run.outline.chunks:
            follow(place.offset / run.outline.size)
            copy.add_chunk(place)
        return copy.finish(out)


class _Copy:
    """A new recording that is being filled from an old one."""

    def __init__(self, run: RunReader, file: BinaryIO) -> None:
        self._run = run
        self._messages = self._cut_messages = self._last_ns = 0
        self._productions = 0
        self._last_cycle = -1
        self._end_cycle: int | None = None
        self._gaps = RunGaps(run.plan)
        self._damaged: list[DamagedChunk] = []
        self._writer = Writer(file, compression=CompressionType.LZ4)
        self._write_origin(run.outline)
        self._channel_of = self._register(run.outline)
        self._port_of = {
            number: run.plan.keys.port(channel.topic)
            for number, channel in run.outline.channels.items()
        }

    def add_chunk(self, place: ChunkPlace) -> None:
        """Copy the messages of a chunk; note it if it cannot be read."""
        try:
            records = unpack_chunk(self._run.file, place)
            for raw in messages_in(records, self._channel_of):
                if place.cut and cycle_of(raw[4]) > self._run.plan.cycles:
                    return
                self._add(raw)
                self._cut_messages += place.cut
        except (DamagedChunkError, msgspec.DecodeError) as error:
            # A cut chunk has no checksum: it is read for as long as it decodes.
            if not place.cut:
                self._damaged.append(
                    DamagedChunk(place.offset, place.first_ns, place.last_ns, str(error))
                )

    def finish(self, out: Path) -> Recovery:
        """Write where the file is from, and its index."""
        run = self._run
        early = {} if self._end_cycle is None else self._gaps.end(self._end_cycle)
        recovery = Recovery(
            source=str(run.path),
            out=str(out),
            closed=run.outline.closed,
            ended=self._end_cycle is not None and self._end_cycle == self._productions,
            messages=self._messages,
            complete_cycles=self._productions,
            last_cycle=self._last_cycle,
            planned_cycles=run.plan.cycles,
            last_ns=self._last_ns,
            cut_bytes=0 if run.outline.closed else run.outline.size - run.outline.readable_end,
            cut_messages=self._cut_messages,
            lost=self._gaps.lost,
            early_ports=len(early),
            early_messages=sum(map(len, early.values())),
            damaged=tuple(self._damaged),
            damaged_attachments=tuple(run.outline.damaged_attachments),
        )
        metadata = {
            "recovered_from": run.path.name,
            "lossless": str(recovery.lossless).lower(),
            "cut_bytes": str(recovery.cut_bytes),
            "damaged_chunks": str(len(recovery.damaged)),
        }
        if recovery.damaged_attachments:
            # Their new checksums will be right.
            metadata["damaged_attachments"] = ", ".join(recovery.damaged_attachments)
        self._writer.add_metadata(RECOVERY_METADATA, metadata)
        self._writer.finish()
        return recovery

    def _add(self, raw: RawMessage) -> None:
        channel, sequence, log_time_ns, publish_time_ns, payload = raw
        head = head_of(payload)
        cycle, port = head.cycle, self._port_of[channel]
        if port is not None and port.signal is RUN:
            message = decode(RUN, payload)
            self._end_cycle = message.cycle if message.state == "stop" else self._end_cycle
        else:
            self._productions += port is not None and port.signal is PRODUCTION
            self._last_cycle = max(self._last_cycle, cycle)
        if port is not None:
            self._gaps.see(port, cycle, sequence, head.incarnation)
        self._writer.add_message(
            self._channel_of[channel], log_time_ns, payload, publish_time_ns, sequence
        )
        self._messages += 1
        self._last_ns = log_time_ns

    def _write_origin(self, outline: Outline) -> None:
        header = outline.header
        self._writer.start(header.profile if header else "", header.library if header else "")
        for entry in outline.attachments:
            self._writer.add_attachment(
                entry.create_time, entry.log_time, entry.name, entry.media_type, entry.data
            )
        for record in outline.metadata:
            self._writer.add_metadata(record.name, record.metadata)

    def _register(self, outline: Outline) -> dict[int, int]:
        """Declare schemas and channels anew; return the channels' new numbers by their old ones."""
        schema_of = {0: 0}
        for number, schema in sorted(outline.schemas.items()):
            schema_of[number] = self._writer.register_schema(
                schema.name, schema.encoding, schema.data
            )
        return {
            number: self._writer.register_channel(
                channel.topic,
                channel.message_encoding,
                schema_of[channel.schema_id],
                channel.metadata,
            )
            for number, channel in sorted(outline.channels.items())
        }
