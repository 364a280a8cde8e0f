"""The messages in the chunks of an MCAP file, read in bulk.

A recording is a row of compressed chunks. The mcap library makes one Python object after another
of what is in them; here the records are taken apart where they lie, which is some 14 times
faster and leaves out what nobody asked for (docs/recordings.md has the measurement).
"""

from __future__ import annotations

import zlib
from collections.abc import Container, Iterator
from struct import Struct, error
from typing import BinaryIO, Final, NamedTuple, TypeAlias

import lz4.frame
import zstandard
from mcap.opcode import Opcode

RawMessage: TypeAlias = tuple[int, int, int, int, bytes]
"""Channel, sequence number, log time [ns], publish time [ns], payload."""

RECORD_HEAD: Final = Struct("<BQ")
"""Of every record: opcode, length of what follows."""

_CHUNK_HEAD: Final = Struct("<QQQII")
"""Of a chunk: first and last log time, size and checksum unpacked, length of the codec's name."""

_MESSAGE_HEAD: Final = Struct("<BQHIQQ")
"""Of a message: opcode, length, channel, sequence number, log time, publish time."""

_FRONT: Final = 4096
"""Bytes of a chunk that tell its times; also enough for the name of any codec."""


class DamagedChunkError(ValueError):
    """What a chunk holds is not what was written."""


class ChunkPlace(NamedTuple):
    """Where a chunk lies in its file, and what is known of it without unpacking it.

    Attributes
    ----------
    offset, length
        First byte of its record, and length of the record's body as the record says.
    first_ns, last_ns
        Log time of its first and of its last message [ns].
    cut
        Whether the file ends before the chunk does.
    """

    offset: int
    length: int
    first_ns: int
    last_ns: int
    cut: bool = False


def chunk_at(file: BinaryIO, offset: int, length: int, size: int) -> ChunkPlace:
    """Look at the head of a chunk's record.

    Parameters
    ----------
    file
        The MCAP file.
    offset, length
        Of the record, as it says itself.
    size
        Of the file.

    Raises
    ------
    struct.error
        The file ends before the chunk's times.
    """
    file.seek(offset + RECORD_HEAD.size)
    first_ns, last_ns, *_ = _CHUNK_HEAD.unpack_from(file.read(_CHUNK_HEAD.size))
    cut = offset + RECORD_HEAD.size + length > size
    return ChunkPlace(offset, length, first_ns, last_ns, cut)


def unpack_chunk(file: BinaryIO, place: ChunkPlace) -> bytes:
    """Return the records in a chunk; of one that was cut, those that can still be unpacked.

    Raises
    ------
    DamagedChunkError
        It cannot be unpacked, or its checksum is not right.
    """
    file.seek(place.offset + RECORD_HEAD.size)
    body = file.read(place.length)
    try:
        _, _, size, checksum, name_length = _CHUNK_HEAD.unpack_from(body)
        begin = _CHUNK_HEAD.size + name_length
        codec = body[_CHUNK_HEAD.size : begin].decode()
        packed = memoryview(body)[begin + 8 :]  # the length of what is packed stands before it
        records = _unpack(codec, packed, size, cut=place.cut)
    except (error, ValueError, EOFError, RuntimeError, zstandard.ZstdError) as reason:
        if place.cut:
            return b""
        raise DamagedChunkError(f"it does not unpack ({reason})") from None
    if not place.cut and checksum and zlib.crc32(records) != checksum:
        raise DamagedChunkError("its checksum is not that of its content")
    return records


def _unpack(codec: str, packed: memoryview, size: int, *, cut: bool) -> bytes:
    match codec:
        case "lz4":
            # Block after block: the blocks before a cut are all there.
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed))
        case "zstd":
            if cut:
                return bytes(zstandard.ZstdDecompressor().decompressobj().decompress(packed))
            return bytes(zstandard.ZstdDecompressor().decompress(packed, size))
        case "":
            return bytes(packed)
    raise DamagedChunkError(f"it is packed by {codec!r}, accepted are lz4 and zstd")


def messages_in(records: bytes, channels: Container[int]) -> Iterator[RawMessage]:
    """Yield the messages of some channels in a chunk's records, in the order of the file.

    A message that a cut has left incomplete is left out, and so is everything behind it.

    Parameters
    ----------
    records
        What `unpack_chunk` returned.
    channels
        Which; the payloads of others are not touched.
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


def others_in(records: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and body of the records in a chunk that are no messages: schemas, channels."""
    begin = 0
    while begin + RECORD_HEAD.size <= len(records):
        opcode, length = RECORD_HEAD.unpack_from(records, begin)
        body = begin + RECORD_HEAD.size
        begin = body + length
        if opcode != Opcode.MESSAGE and begin <= len(records):
            yield opcode, records[body:begin]
