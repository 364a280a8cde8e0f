"""The messages in the chunks of an MCAP file, read in bulk.

The mcap library makes a Python object of every record; here messages are unpacked where they lie.
That is about 14 times faster (docs/recordings.md has the measurement).
"""

from __future__ import annotations

import zlib
from collections.abc import Container, Iterator
from struct import Struct
from struct import error as StructError  # noqa: N812
from typing import BinaryIO, Final, NamedTuple, TypeAlias

import lz4.frame
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from bus_schemas.errors import InputError

RawMessage: TypeAlias = tuple[int, int, int, int, bytes]
"""Channel, sequence number, log time [ns], publish time [ns], payload."""

LARGEST_CHUNK: Final = 1 << 26
"""A chunk that unpacks to more bytes is damaged; those of a recording have about 1 MiB."""

RECORD_HEAD: Final = Struct("<BQ")
"""Of every record: opcode, length of what follows."""

BROKEN: Final = (
    *(McapError, StructError, ValueError, EOFError, RuntimeError, OverflowError, MemoryError),
)
"""What reading a damaged record can raise."""

_CHUNK_HEAD: Final = Struct("<QQQII")
"""Of a chunk: first and last log time, size and checksum unpacked, length of the codec's name."""

_MESSAGE_HEAD: Final = Struct("<BQHIQQ")
"""Of a message: opcode, length, channel, sequence number, log time, publish time."""

_ANOTHER_CODEC: Final = b"zstd"
"""What other tools use."""

_PACKED_LENGTH_SIZE: Final = 8
"""Bytes between the codec's name and the packed data."""


class DamagedChunkError(ValueError):
    """A chunk does not hold what was written."""


class ChunkPlace(NamedTuple):
    """Where a chunk's record begins, the length of its body, and its first and last log time.

    `file` is which of a recording's files it is in.
    """

    offset: int
    length: int
    first_ns: int
    last_ns: int
    file: int = 0


def chunk_at(file: BinaryIO, offset: int, length: int) -> ChunkPlace:
    """Read the head of a chunk's record, which says it has `length` bytes."""
    file.seek(offset + RECORD_HEAD.size)
    first_ns, last_ns, *_ = _CHUNK_HEAD.unpack(file.read(_CHUNK_HEAD.size))
    return ChunkPlace(offset, length, first_ns, last_ns)


def check_codec(file: BinaryIO, place: ChunkPlace) -> None:
    """Refuse a chunk that another tool has packed anew: it is not damaged."""
    file.seek(place.offset + RECORD_HEAD.size + _CHUNK_HEAD.size)
    if file.read(len(_ANOTHER_CODEC)) == _ANOTHER_CODEC:
        raise InputError(f"{file.name}: another tool has packed it anew: expected lz4, got zstd")


def unpack_chunk(file: BinaryIO, place: ChunkPlace) -> bytes:
    """Return the records in a chunk; DamagedChunkError if it does not hold what was written."""
    file.seek(place.offset + RECORD_HEAD.size)
    try:
        body = file.read(min(place.length, LARGEST_CHUNK))
        *_, size, checksum, name_length = _CHUNK_HEAD.unpack_from(body)
        codec = body[_CHUNK_HEAD.size :][:name_length]
        if codec != b"lz4":
            raise ValueError(f"expected lz4, got {codec!r}")
        packed = body[_CHUNK_HEAD.size + name_length + _PACKED_LENGTH_SIZE :]
        records = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=LARGEST_CHUNK)
        if len(records) != size or zlib.crc32(records) != checksum:
            raise ValueError("its checksum or its length is wrong")
    except BROKEN as reason:
        raise DamagedChunkError(f"it does not unpack ({reason})") from None
    return bytes(records)


def messages_in(records: bytes, channels: Container[int]) -> Iterator[RawMessage]:
    """Yield the messages of some channels among a chunk's records, in the order of the file.

    An incomplete message ends the reading.
    """
    head, end = _MESSAGE_HEAD, len(records)
    last = end - head.size
    begin = 0
    while begin <= last:
        opcode, length, channel, sequence, log_time_ns, publish_time_ns = head.unpack_from(
            records, begin
        )
        next_record = begin + RECORD_HEAD.size + length
        if next_record > end:
            return
        if opcode == Opcode.MESSAGE and channel in channels:
            payload = records[begin + head.size : next_record]
            yield channel, sequence, log_time_ns, publish_time_ns, payload
        begin = next_record
