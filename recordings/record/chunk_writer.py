"""Writes an MCAP file without an index of messages: its memory does not grow with the file.

The mcap library's writer keeps an index of every chunk, and of every message, until it closes the
file. Readers of recordings find chunks by their lengths; `export` makes files with all indexes.
"""

from __future__ import annotations

import zlib
from collections import Counter
from typing import BinaryIO, Final

import lz4.frame
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from recordings.read.mcap_file import MAGIC, MESSAGE_HEAD

_CHUNK_SIZE: Final = 1 << 20
_FIELDS_SIZE: Final = MESSAGE_HEAD.size - 9
"""Bytes of a message's record between its length and its payload."""


class ChunkWriter:
    """Used as the mcap library's `Writer`; `recorded` counts the messages by channel."""

    def __init__(self, file: BinaryIO, profile: str, library: str) -> None:
        self.recorded: Counter[int] = Counter()
        self._file = file
        self._schemas = self._channels = 0
        self._declared = bytearray()
        self._indexes: list[records.AttachmentIndex | records.MetadataIndex] = []
        self._chunks = 0
        self._chunk = bytearray()
        self._chunk_begin_ns: int | None = None
        self._begin_ns = self._end_ns = 0
        self._file.write(MAGIC + _bytes(records.Header(library=library, profile=profile)))

    def add_attachment(
        self, create_time: int, log_time: int, name: str, media_type: str, data: bytes
    ) -> None:
        entry = records.Attachment(
            create_time=create_time, log_time=log_time, name=name, media_type=media_type, data=data
        )
        position = self._file.tell(), self._file.write(_bytes(entry))
        index = records.AttachmentIndex(
            *position, log_time, create_time, len(data), name, media_type
        )
        self._indexes.append(index)

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        position = self._file.tell(), self._file.write(_bytes(records.Metadata(name, data)))
        self._indexes.append(records.MetadataIndex(*position, name))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        self._schemas += 1
        schema = records.Schema(id=self._schemas, name=name, encoding=encoding, data=data)
        self._declare(_bytes(schema))
        return self._schemas

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str]
    ) -> int:
        """Declare a channel. A plant of 10,000 inverters has 60,000 of them."""
        self._channels += 1
        entries = b"".join(_text(key) + _text(value) for key, value in metadata.items())
        ids = self._channels.to_bytes(2, "little") + schema_id.to_bytes(2, "little")
        body = ids + _text(topic) + _text(message_encoding) + _sized(entries)
        self._declare(bytes([Opcode.CHANNEL]) + len(body).to_bytes(8, "little") + body)
        return self._channels

    def _declare(self, record: bytes) -> None:
        """Write a schema or a channel, and keep it for the summary."""
        self._chunk += record
        self._declared += record

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int
    ) -> None:
        chunk, length = self._chunk, _FIELDS_SIZE + len(data)
        chunk += MESSAGE_HEAD.pack(
            Opcode.MESSAGE, length, channel_id, sequence, log_time, publish_time
        )
        chunk += data
        self.recorded[channel_id] += 1
        if self._chunk_begin_ns is None:
            self._chunk_begin_ns = log_time
        self._end_ns = log_time  # Messages come in the order of their log times.
        if len(chunk) > _CHUNK_SIZE:
            self._end_chunk()

    def flush(self) -> None:
        self._end_chunk()
        self._file.flush()

    def finish(self) -> None:
        """End the messages and write the summary. The file stays open."""
        self._end_chunk()
        self._file.write(_bytes(records.DataEnd(data_section_crc=0)))
        begin = self._file.tell()
        attached = sum(isinstance(entry, records.AttachmentIndex) for entry in self._indexes)
        statistics = records.Statistics(
            attachment_count=attached,
            channel_count=self._channels,
            channel_message_counts=dict(self.recorded),
            chunk_count=self._chunks,
            message_count=self.recorded.total(),
            message_end_time=self._end_ns,
            message_start_time=self._begin_ns,
            metadata_count=len(self._indexes) - attached,
            schema_count=self._schemas,
        )
        summary = bytes(self._declared) + _bytes(statistics, *self._indexes)
        footer = records.Footer(summary_start=begin, summary_offset_start=0, summary_crc=0)
        checked = (summary + _bytes(footer))[:-4]  # All but the checksum itself.
        self._file.write(checked + zlib.crc32(checked).to_bytes(4, "little") + MAGIC)
        self._file.flush()

    def _end_chunk(self) -> None:
        if self._chunk_begin_ns is None:
            return
        content = bytes(self._chunk)
        chunk = records.Chunk(
            compression="lz4",
            data=lz4.frame.compress(content),
            message_start_time=self._chunk_begin_ns,
            message_end_time=self._end_ns,
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        self._begin_ns = self._begin_ns or self._chunk_begin_ns
        self._chunks += 1
        self._chunk.clear()
        self._chunk_begin_ns = None
        self._file.write(_bytes(chunk))


def _bytes(*entries: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    for entry in entries:
        entry.write(builder)
    content: bytes = builder.end()
    return content


def _sized(content: bytes) -> bytes:
    return len(content).to_bytes(4, "little") + content


def _text(value: str) -> bytes:
    return _sized(value.encode())
