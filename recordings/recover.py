"""Makes a whole recording of a cut one: everything up to the cut, with a new index."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import msgspec
from mcap.writer import CompressionType, Writer

from bus_schemas.codec import decode
from bus_schemas.signals import PRODUCTION, RUN
from bus_schemas.tree import ROOT
from recordings.read.chunks import ChunkPlace, DamagedChunkError, RawMessage, messages_in
from recordings.read.gaps import RunGaps
from recordings.read.outline import Outline
from recordings.read.reader import Head, RunReader, end_of_run, head_of
from recordings.read.whole_file import new_path

RECOVERY_METADATA: Final = "recovery"
"""Name of the metadata of a recovered file."""


class DamagedChunk(msgspec.Struct, frozen=True):
    """A chunk that could not be read: where, when it was recorded (wall clock), and why."""

    offset: int
    first_ns: int
    last_ns: int
    reason: str


class Recovery(msgspec.Struct, kw_only=True):
    """The result of a recovery.

    `closed`: the recorder had come to its end. `ended`: the recording goes up to the end of the
    run. `cut_bytes` at the end of the file make up no whole record; `cut_messages` could be read of
    them, and no checksum verifies those. `lost` messages are missing between others; on
    `early_ports`, `early_messages` were due up to the end of the run.
    """

    source: str
    out: str
    closed: bool
    ended: bool = False
    messages: int = 0
    complete_cycles: int = 0
    last_cycle: int = -1
    planned_cycles: int
    last_ns: int = 0
    cut_bytes: int
    cut_messages: int = 0
    lost: int = 0
    early_ports: int = 0
    early_messages: int = 0
    damaged: list[DamagedChunk] = []
    damaged_attachments: list[str]

    @property
    def lossless(self) -> bool:
        """Whether nothing that was recorded can be missing."""
        missing = self.lost or self.early_ports or self.damaged or self.damaged_attachments
        return (self.closed or self.ended) and not missing


def is_sound(run: RunReader) -> bool:
    """Whether a recording was closed in order and all of it can be read."""
    if not run.whole or run.outline.damaged_attachments:
        return False
    for place in run.followed_chunks():
        try:
            run.unpack(place)
        except DamagedChunkError:
            return False
    return True


def recover_run(run: RunReader, out: Path) -> Recovery:
    """Copy all of a recording that can be read into a new one.

    Attachments, metadata, schemas and channels are the same; so are the messages, byte for byte,
    with their times, sequence numbers and order. Metadata named `recovery` is added.
    """
    outline, gaps, stops = run.outline, RunGaps(run.plan), set[int]()
    found = Recovery(
        source=str(run.path),
        out=str(out),
        closed=outline.closed,
        planned_cycles=run.plan.cycles,
        cut_bytes=0 if outline.closed else max(outline.size - outline.readable_end, 0),
        damaged_attachments=outline.damaged_attachments,
    )
    with new_path(out) as beside, beside.open("xb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        channel_of = _begin(writer, outline)
        for place in run.followed_chunks():
            for raw, head in _readable(run, place, found):
                channel, sequence, log_time_ns, publish_time_ns, payload = raw
                writer.add_message(
                    channel_of[channel], log_time_ns, payload, publish_time_ns, sequence
                )
                found.messages += 1
                found.cut_messages += place.cut
                found.last_ns = log_time_ns
                port = run.channels.get(channel)
                if port is not None:
                    gaps.see(port, head.cycle, sequence, head.incarnation)
                if port is None or port.signal is not RUN:
                    found.last_cycle = max(found.last_cycle, head.cycle)
                elif _is_stop(payload):
                    stops.add(head.cycle)
        found.complete_cycles = gaps.ports[PRODUCTION.of(ROOT)].messages
        end_cycle = end_of_run(stops, found.last_cycle)
        found.ended = end_cycle == found.complete_cycles
        found.lost = gaps.lost
        if end_cycle is not None:
            early = gaps.end(end_cycle)
            found.early_ports, found.early_messages = len(early), sum(map(len, early.values()))
        writer.add_metadata(RECOVERY_METADATA, _metadata(found, run.path))
        writer.finish()
    return found


def _readable(
    run: RunReader, place: ChunkPlace, found: Recovery
) -> Iterator[tuple[RawMessage, Head]]:
    """Yield the messages of a chunk; note the chunk if it is damaged."""
    try:
        for raw in messages_in(run.unpack(place), run.outline.channels):
            head = head_of(raw[4])
            if place.cut and head.cycle > run.plan.cycles:
                return
            yield raw, head
    except (DamagedChunkError, msgspec.DecodeError) as error:
        # A cut chunk has no checksum: it is read for as long as it decodes.
        if not place.cut:
            damage = DamagedChunk(place.offset, place.first_ns, place.last_ns, str(error))
            found.damaged.append(damage)


def _is_stop(payload: bytes) -> bool:
    try:
        return decode(RUN, payload).state == "stop"
    except msgspec.DecodeError:
        return False


def _metadata(found: Recovery, source: Path) -> dict[str, str]:
    metadata = {
        "recovered_from": source.name,
        "lossless": str(found.lossless).lower(),
        "cut_bytes": str(found.cut_bytes),
        "damaged_chunks": str(len(found.damaged)),
    }
    if found.damaged_attachments:
        # In the new file their checksums are right.
        metadata["damaged_attachments"] = ", ".join(found.damaged_attachments)
    return metadata


def _begin(writer: Writer, outline: Outline) -> dict[int, int]:
    """Copy all but the messages; return the channels' new numbers by their old ones."""
    header = outline.header
    writer.start(header.profile if header else "", header.library if header else "")
    for entry in outline.attachments:
        writer.add_attachment(
            entry.create_time, entry.log_time, entry.name, entry.media_type, entry.data
        )
    for name, entries in outline.metadata.items():
        writer.add_metadata(name, entries)
    schema_of = {0: 0}
    for number, schema in sorted(outline.schemas.items()):
        schema_of[number] = writer.register_schema(schema.name, schema.encoding, schema.data)
    return {
        number: writer.register_channel(
            channel.topic,
            channel.message_encoding,
            schema_of[channel.schema_id],
            channel.metadata,
        )
        for number, channel in sorted(outline.channels.items())
    }
