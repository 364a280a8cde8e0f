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

_LENGTH: Final = Struct("<Q")
"""Of what is packed, before it."""

_LONGEST_NAME: Final = 64
"""Bytes: the name of no codec is longer."""

_CODECS: Final = (b"lz4", b"zstd")
_BLOCK: Final = 1 << 20
_ALL_CHANNELS: Final = range(1 << 16)


_UNPACKING: Final = (
    error,
    ValueError,
    EOFError,
    RuntimeError,
    OverflowError,
    MemoryError,
    zstandard.ZstdError,
)
"""What unpacking something can lead to that is not what was packed."""


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


def is_chunk(file: BinaryIO, offset: int) -> bool:
    """Whether a chunk begins at a byte: its record's length fits that of what is packed in it."""
    file.seek(offset)
    front = file.read(RECORD_HEAD.size + _CHUNK_HEAD.size + _LONGEST_NAME + _LENGTH.size)
    try:
        opcode, length = RECORD_HEAD.unpack_from(front)
        *_, name_length = _CHUNK_HEAD.unpack_from(front, RECORD_HEAD.size)
        before = _CHUNK_HEAD.size + name_length
        (packed_length,) = _LENGTH.unpack_from(front, RECORD_HEAD.size + before)
    except error:
        return False
    fits: bool = length == before + _LENGTH.size + packed_length
    return fits and opcode == Opcode.CHUNK


def find_chunk(file: BinaryIO, begin: int, end: int) -> int | None:
    """Return the first byte of the next compressed chunk in a part of a file; None: there is none.

    This is how to go on behind a record that does not tell where the next one begins.
    """
    before_name = RECORD_HEAD.size + _CHUNK_HEAD.size
    marks = [Struct("<I").pack(len(name)) + name for name in _CODECS]
    overlap = before_name + max(map(len, marks))
    for block_begin in range(begin, end, _BLOCK):
        file.seek(block_begin)
        block = file.read(min(_BLOCK + overlap, end - block_begin))
        found = []
        for mark in marks:
            at = block.find(mark)
            while at >= 0:
                found.append(block_begin + at + 4 - before_name)
                at = block.find(mark, at + 1)
        for offset in sorted(found):
            if offset >= begin and is_chunk(file, offset):
                return offset
    return None


def unpack_chunk(file: BinaryIO, place: ChunkPlace) -> bytes:
    """Return the records in a chunk; of one that was cut, those that can still be unpacked.

    What is left of a chunk that was cut is not verified: its checksum is that of all of it.

    Raises
    ------
    DamagedChunkError
        No chunk is at its place, it cannot be unpacked, or it is not what its head says.
    """
    if place.cut:
        return _unpack_cut(file, place)
    if not is_chunk(file, place.offset):
        raise DamagedChunkError("no chunk begins there")
    file.seek(place.offset)
    _, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
    if length != place.length:
        raise DamagedChunkError(f"its length is {length:,} bytes, and not {place.length:,}")
    try:
        codec, size, checksum, packed = _take_apart(file.read(place.length))
        records = _unpack(codec, packed, size, cut=False)
    except _UNPACKING as reason:
        raise DamagedChunkError(f"it does not unpack ({reason})") from None
    if len(records) != size:
        raise DamagedChunkError(f"{len(records):,} bytes unpack of it, and not {size:,}")
    if checksum and zlib.crc32(records) != checksum:
        raise DamagedChunkError("its checksum is not that of its content")
    if not checksum:
        _check_records(records)  # Our writer always gives one; MCAP does not ask for it.
    return records


def times_in(records: bytes) -> tuple[int, int] | None:
    """Return the first and the last log time of the messages in a chunk; None: it has none."""
    times_ns = [raw[2] for raw in messages_in(records, _ALL_CHANNELS)]
    return (min(times_ns), max(times_ns)) if times_ns else None


def _unpack_cut(file: BinaryIO, place: ChunkPlace) -> bytes:
    # Its length may be damaged too, so all that is there is read, and not what it says.
    file.seek(place.offset + RECORD_HEAD.size)
    try:
        codec, size, _, packed = _take_apart(file.read())
        return _unpack(codec, packed, size, cut=True)
    except _UNPACKING:
        return b""


def _take_apart(body: bytes) -> tuple[str, int, int, memoryview]:
    """Return codec, size and checksum of a chunk, and what is packed in it."""
    _, _, size, checksum, name_length = _CHUNK_HEAD.unpack_from(body)
    begin = _CHUNK_HEAD.size + name_length
    codec = body[_CHUNK_HEAD.size : begin].decode()
    return codec, size, checksum, memoryview(body)[begin + _LENGTH.size :]


def _check_records(records: bytes) -> None:
    """Refuse what is not a row of records from its first to its last byte."""
    begin, end = 0, len(records)
    while begin < end:
        if begin + RECORD_HEAD.size > end:
            raise DamagedChunkError("a record in it is incomplete")
        opcode, length = RECORD_HEAD.unpack_from(records, begin)
        if not opcode:
            raise DamagedChunkError("a record in it is none")
        begin += RECORD_HEAD.size + length
    if begin > end:
        raise DamagedChunkError("a record in it reaches beyond its end")


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
