"""The parts of an MCAP file: its chunks, and what its index or a walk over its records finds.

A file that was cut has no index. Its chunks are found by their lengths, without unpacking them, so
a cut recording is read like a whole one, up to the cut.

The mcap library makes a Python object of every record; here messages are unpacked where they lie.
That is about 14 times faster (docs/recordings.md has the measurement).
"""

from __future__ import annotations

import zlib
from collections.abc import Container, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from os import SEEK_END
from struct import Struct
from struct import error as StructError  # noqa: N812
from typing import BinaryIO, Final, NamedTuple, TypeAlias

import lz4.frame
from mcap import records
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

from bus_schemas.errors import InputError

_MAGIC: Final = b"\x89MCAP0\r\n"
_FOOTER: Final = Struct("<BQQQI")
"""The footer: opcode, length, begin of the index, begin of its offsets, checksum of the index."""

_CHUNK_INDEX: Final = Struct("<QQQQ")
"""In the index of a chunk: its first and last log time, where it begins, length of its record."""

_OPCODES: Final = frozenset(Opcode)
_BLOCK: Final = 1 << 20

RawMessage: TypeAlias = tuple[int, int, int, int, bytes]
"""Channel, sequence number, log time [ns], publish time [ns], payload."""

_LARGEST_CHUNK: Final = 1 << 26
"""A chunk that unpacks to more bytes is damaged; those of a recording have about 1 MiB."""

_RECORD_HEAD: Final = Struct("<BQ")
"""Of every record: opcode, length of what follows."""

_BROKEN: Final = (
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


class Chunk(NamedTuple):
    """Where a chunk's record begins, the length of its body, and its first and last log time.

    `file` is which of a recording's files it is in.
    """

    offset: int
    length: int
    first_ns: int
    last_ns: int
    file: int = 0


def _chunk_at(file: BinaryIO, offset: int, length: int) -> Chunk:
    """Read the head of a chunk's record, which says it has `length` bytes."""
    file.seek(offset + _RECORD_HEAD.size)
    first_ns, last_ns, *_ = _CHUNK_HEAD.unpack(file.read(_CHUNK_HEAD.size))
    return Chunk(offset, length, first_ns, last_ns)


def check_codec(file: BinaryIO, chunk: Chunk) -> None:
    """Refuse a chunk that another tool has packed anew: it is not damaged."""
    file.seek(chunk.offset + _RECORD_HEAD.size + _CHUNK_HEAD.size)
    if file.read(len(_ANOTHER_CODEC)) == _ANOTHER_CODEC:
        raise InputError(f"{file.name}: another tool has packed it anew: expected lz4, got zstd")


def unpack_chunk(file: BinaryIO, chunk: Chunk) -> bytes:
    """Return the records in a chunk; DamagedChunkError if it does not hold what was written."""
    file.seek(chunk.offset + _RECORD_HEAD.size)
    try:
        body = file.read(min(chunk.length, _LARGEST_CHUNK))
        *_, size, checksum, name_length = _CHUNK_HEAD.unpack_from(body)
        codec = body[_CHUNK_HEAD.size :][:name_length]
        if codec != b"lz4":
            raise ValueError(f"expected lz4, got {codec!r}")
        packed = memoryview(body)[_CHUNK_HEAD.size + name_length + _PACKED_LENGTH_SIZE :]
        # A buffer of the most that is allowed would take twice as long.
        most = min(size, _LARGEST_CHUNK)
        content = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=most)
        if len(content) != size or zlib.crc32(content) != checksum:
            raise ValueError("its checksum or its length is wrong")
    except _BROKEN as reason:
        raise DamagedChunkError(f"it does not unpack ({reason})") from None
    return bytes(content)


def messages_in(content: bytes, channels: Container[int]) -> Iterator[RawMessage]:
    """Yield the messages of some channels among a chunk's records, in the order of the file.

    An incomplete message ends the reading.
    """
    head, end = _MESSAGE_HEAD, len(content)
    last = end - head.size
    begin = 0
    while begin <= last:
        opcode, length, channel, sequence, log_time_ns, publish_time_ns = head.unpack_from(
            content, begin
        )
        next_record = begin + _RECORD_HEAD.size + length
        if next_record > end:
            return
        if opcode == Opcode.MESSAGE and channel in channels:
            payload = content[begin + head.size : next_record]
            yield channel, sequence, log_time_ns, publish_time_ns, payload
        begin = next_record


class _Span(NamedTuple):
    """Where a record lies: its first byte, and the length of its body."""

    opcode: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        """The first byte behind the record."""
        return self.offset + _RECORD_HEAD.size + self.length


@dataclass
class Outline:
    """What a file consists of, in its order; metadata by name, channels by their id.

    It is `closed` if its writer came to the end of the messages. Otherwise it was cut, is damaged
    at `readable_end`, or is still being written. It is `indexed` if it has its index too. The
    checksums of `damaged_attachments` are wrong.

    A recording may go on in further files. Then `size`, `closed` and `readable_end` are those of
    the last one, of the number `file`, and it is `indexed` if all of them are.
    """

    size: int
    closed: bool = False
    indexed: bool = False
    readable_end: int = len(_MAGIC)
    header: records.Header | None = None
    attachments: list[records.Attachment] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    damaged_attachments: list[str] = field(default_factory=list)
    file: int = 0

    @property
    def cut_early(self) -> bool:
        return not self.closed and not self.chunks

    def append(self, other: Outline) -> None:
        """Add the outline of a further file."""
        self.file += 1
        self.chunks += [chunk._replace(file=self.file) for chunk in other.chunks]
        self.channels = self.channels or other.channels
        self.size, self.readable_end, self.closed = other.size, other.readable_end, other.closed
        self.indexed &= other.indexed


def read_outline(file: BinaryIO) -> Outline:
    """Return what an MCAP file consists of. An empty file counts as cut."""
    size = file.seek(0, SEEK_END)
    file.seek(0)
    magic = file.read(len(_MAGIC))
    if not _MAGIC.startswith(magic):
        raise InputError(f"{file.name}: not an MCAP file, it begins with {magic!r}")
    with suppress(*_BROKEN):  # The file was cut, or its index is damaged.
        return _by_index(file, size)
    outline = Outline(size=0)
    walk_on(outline, file)
    return outline


def _by_index(file: BinaryIO, size: int) -> Outline:
    """Read the index at the end of a file, if it has a sound one."""
    end = size - _FOOTER.size - len(_MAGIC)
    file.seek(max(end, 0))
    tail = file.read()
    opcode, _, begin, _, checksum = _FOOTER.unpack_from(tail)
    if not tail.endswith(_MAGIC) or opcode != Opcode.FOOTER or not begin:
        raise ValueError("no index")
    if _checksum(file, begin, size - len(_MAGIC) - 4) != checksum:
        raise ValueError("a damaged index")
    outline = Outline(size, closed=True, indexed=True, readable_end=begin)
    elsewhere = [len(_MAGIC)]  # Where the header, attachments and metadata lie.
    for span in _walk(file, begin, end):
        content = _content(file, span, size)
        if span.opcode == Opcode.CHUNK_INDEX:
            # The library would make a dictionary of channels for each of 170,000 chunks a day.
            first_ns, last_ns, offset, length = _CHUNK_INDEX.unpack_from(content, _RECORD_HEAD.size)
            chunk = Chunk(offset, length - _RECORD_HEAD.size, first_ns, last_ns)
            outline.chunks.append(chunk)
            continue
        for entry in _records_in(content):
            if isinstance(entry, records.AttachmentIndex | records.MetadataIndex):
                elsewhere.append(entry.offset)
            _enter(outline, entry)
    for offset in elsewhere:
        _take(outline, file, _span_at(file, offset))
    return outline


def _checksum(file: BinaryIO, begin: int, end: int) -> int:
    checksum = 0
    file.seek(begin)
    while begin < end:
        block = file.read(min(end - begin, _BLOCK))
        checksum = zlib.crc32(block, checksum)
        begin += len(block)
    return checksum


def walk_on(outline: Outline, file: BinaryIO) -> None:
    """Go from record to record, to the end of the file or to its cut.

    A second call goes on from there, since a file that is being written grows.
    """
    outline.size = size = file.seek(0, SEEK_END)
    for span in _walk(file, outline.readable_end, size):
        if span.end > size:
            break
        with suppress(*_BROKEN):  # A damaged record still tells where the next one begins.
            _take(outline, file, span)
        outline.readable_end = span.end
        if span.opcode == Opcode.DATA_END:
            outline.closed = True
            break


def _take(outline: Outline, file: BinaryIO, span: _Span) -> None:
    """Enter a record of the data section into the outline."""
    if span.opcode == Opcode.CHUNK:
        chunk = _chunk_at(file, span.offset, span.length)._replace(file=outline.file)
        outline.chunks.append(chunk)
        if len(outline.chunks) == 1:
            # A recording declares all its channels before its first message.
            for entry in _records_in(unpack_chunk(file, chunk)):
                _enter(outline, entry)
    elif span.opcode in {Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA}:
        content = _content(file, span, outline.size)
        record = next(_records_in(content), None)
        if record is None:
            raise ValueError(f"the record at byte {span.offset} is damaged")
        _enter(outline, record)
        body, checksum = content[_RECORD_HEAD.size : -4], int.from_bytes(content[-4:], "little")
        if isinstance(record, records.Attachment) and zlib.crc32(body) != checksum:
            outline.damaged_attachments.append(record.name)


def _enter(outline: Outline, record: records.McapRecord) -> None:
    match record:
        case records.Header():
            outline.header = record
        case records.Attachment():
            outline.attachments.append(record)
        case records.Metadata():
            outline.metadata[record.name] = record.metadata
        case records.Channel():
            outline.channels[record.id] = record


def _records_in(content: bytes) -> Iterator[records.McapRecord]:
    """Yield the records that some bytes hold, up to a damaged one."""
    with suppress(*_BROKEN):  # The library raises at the end, too.
        yield from StreamReader(BytesIO(content), skip_magic=True).records


def _walk(file: BinaryIO, begin: int, end: int) -> Iterator[_Span]:
    """Yield where the records from one byte to another lie; the last one may reach beyond it."""
    offset = begin
    while offset + _RECORD_HEAD.size <= end:
        span = _span_at(file, offset)
        if span.opcode not in _OPCODES:
            return  # A disk that lost its power leaves zeros.
        yield span
        offset = span.end


def _span_at(file: BinaryIO, offset: int) -> _Span:
    file.seek(offset)
    opcode, length = _RECORD_HEAD.unpack(file.read(_RECORD_HEAD.size))
    return _Span(opcode, offset, length)


def _content(file: BinaryIO, span: _Span, size: int) -> bytes:
    """Return a record as it is in the file."""
    if span.end > size:
        raise ValueError(f"the record at byte {span.offset} reaches beyond the end of the file")
    file.seek(span.offset)
    return file.read(span.end - span.offset)
