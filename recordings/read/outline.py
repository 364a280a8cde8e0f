"""What an MCAP file consists of: found by its index, or by walking from record to record.

A file that was cut has no index. Its chunks are found all the same, without unpacking them, so a
cut recording is read like a whole one, up to the cut.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from os import SEEK_END
from struct import Struct, error
from typing import BinaryIO, Final, NamedTuple, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
)

from recordings.read.chunks import (
    RECORD_HEAD,
    ChunkPlace,
    DamagedChunkError,
    chunk_at,
    find_chunk,
    is_chunk,
    others_in,
    times_in,
    unpack_chunk,
)

MAGIC: Final = b"\x89MCAP0\r\n"
_TIMES: Final = Struct("<QQ")
_FOOTER_SIZE: Final = RECORD_HEAD.size + 20
_CHECKSUM: Final = Struct("<I")
_LARGEST_OPCODE: Final = Opcode.DATA_END
_BLOCK: Final = 1 << 20
_BROKEN: Final = (error, McapError, ValueError, OverflowError, MemoryError)
"""What a record that is not what was written can lead to when it is read."""

R = TypeVar("R", bound=McapRecord)


class NoMcapError(ValueError):
    """The file is no MCAP file at all; says what it is instead."""


class _Place(NamedTuple):
    """Where a record lies: its first byte, and the length of its body."""

    opcode: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        """First byte behind it."""
        return self.offset + RECORD_HEAD.size + self.length


@dataclass
class Outline:
    """What a file consists of.

    Attributes
    ----------
    size
        Of the file [bytes].
    closed
        Whether its writer came to the end of the messages. Otherwise it was cut, or is still being
        written.
    indexed
        Whether it has its index too.
    readable_end
        First byte that belongs to no readable record of the data section.
    header
        None where not even that was written.
    attachments, metadata
        In the order of the file.
    schemas, channels
        By their id.
    chunks
        In the order of the file, those without a message left out. The last one may be cut. A
        place where something else is than what was written is among them, it does not unpack.
    damaged_attachments
        Names of those whose checksum is not that of their content; of one that cannot be read at
        all, where it is.
    """

    size: int
    closed: bool = False
    indexed: bool = False
    readable_end: int = len(MAGIC)
    header: Header | None = None
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    damaged_attachments: list[str] = field(default_factory=list)

    @property
    def cut_early(self) -> bool:
        """Whether it was cut before its first message."""
        return not self.closed and not self.chunks


def read_outline(file: BinaryIO) -> Outline:
    """Find out what an MCAP file consists of.

    Raises
    ------
    NoMcapError
        It does not begin as one.
    """
    size = file.seek(0, SEEK_END)
    file.seek(0)
    magic = file.read(len(MAGIC))
    if magic != MAGIC:
        raise NoMcapError(f"it begins with {magic!r}" if magic else "it is empty")
    try:
        outline = _by_index(file, size)
    except _BROKEN:
        outline = None  # Cut, or its index is damaged: what lies before the index may be sound.
    return outline or _by_walking(file, size)


def _by_index(file: BinaryIO, size: int) -> Outline | None:
    """Read the index at the end of a file; None if it has none."""
    file.seek(max(size - _FOOTER_SIZE - len(MAGIC), 0))
    tail = file.read()
    if not tail.endswith(MAGIC) or tail[0] != Opcode.FOOTER:
        return None
    footer = _parse(Footer.read, tail[RECORD_HEAD.size :])
    begin = footer.summary_start
    if not begin or not _is_sound(file, begin, size - len(MAGIC) - 4, footer.summary_crc):
        return None
    outline = Outline(size, closed=True, indexed=True, readable_end=begin)
    attachments, metadata = [], []
    for place in _walk(file, begin, size - _FOOTER_SIZE - len(MAGIC)):
        match place.opcode:
            case Opcode.SCHEMA | Opcode.CHANNEL:
                _declare(outline, place.opcode, _body(file, place, outline.size))
            case Opcode.CHUNK_INDEX:
                outline.chunks.append(_indexed_chunk(_body(file, place, outline.size)))
            case Opcode.ATTACHMENT_INDEX:
                attachments.append(
                    _parse(AttachmentIndex.read, _body(file, place, outline.size)).offset
                )
            case Opcode.METADATA_INDEX:
                metadata.append(_parse(MetadataIndex.read, _body(file, place, outline.size)).offset)
    outline.header = _parse(Header.read, _body(file, _place_at(file, len(MAGIC)), size))
    for offset in attachments:
        _take_attachment(outline, file, _place_at(file, offset))
    for offset in metadata:
        outline.metadata.append(_parse(Metadata.read, _body(file, _place_at(file, offset), size)))
    return outline


def _is_sound(file: BinaryIO, begin: int, end: int, expected: int) -> bool:
    """Whether the bytes of the index have the checksum that stands behind them (0: none does)."""
    checksum = 0
    file.seek(begin)
    while expected and begin < end:
        block = file.read(min(end - begin, _BLOCK))
        checksum = zlib.crc32(block, checksum)
        begin += len(block)
    return checksum == expected


def _indexed_chunk(body: bytes) -> ChunkPlace:
    # The library would make a dictionary of channels for each chunk: a real-time recording of a
    # day has 170,000 chunks.
    first_ns, last_ns = _TIMES.unpack_from(body)
    offset, length = _TIMES.unpack_from(body, _TIMES.size)
    return ChunkPlace(offset, length - RECORD_HEAD.size, first_ns, last_ns)


def _by_walking(file: BinaryIO, size: int) -> Outline:
    """Go from record to record, from the beginning to the end or to the cut."""
    outline = Outline(size)
    offset = sure = len(MAGIC)  # All up to `sure` was what was written.
    while offset + RECORD_HEAD.size <= size:
        place = _place_at(file, offset)
        if not _is_plausible(file, place, size):
            # A record's length is not verified by anything: the one before may have led astray.
            found = find_chunk(file, sure, size)
            if found is not None:
                _take_damage(outline, offset if found > offset else sure, found)
                offset = found
                continue
        if not 0 < place.opcode <= _LARGEST_OPCODE:
            break  # A disk that lost its power leaves zeros.
        _take(outline, file, place)
        if place.end > size:
            break
        outline.readable_end = offset = place.end
        if place.opcode == Opcode.CHUNK:
            sure = place.end
        if place.opcode == Opcode.DATA_END:
            outline.closed = True
            break
    _mend_times(file, outline.chunks)
    return outline


def _is_plausible(file: BinaryIO, place: _Place, size: int) -> bool:
    """Whether a record can be what was written, as far as can be told without reading it."""
    match place.opcode:
        case Opcode.CHUNK:
            return is_chunk(file, place.offset)
        case Opcode.DATA_END:
            return place.length == _CHECKSUM.size
        case _:
            return 0 < place.opcode <= _LARGEST_OPCODE and place.end <= size


def _take(outline: Outline, file: BinaryIO, place: _Place) -> None:
    try:
        if place.opcode == Opcode.CHUNK:
            _take_chunk(outline, file, place)
        elif place.end <= outline.size:
            _take_other(outline, file, place)
    except _BROKEN:
        pass  # One record is torn: where the next one begins is known all the same.


def _take_chunk(outline: Outline, file: BinaryIO, place: _Place) -> None:
    chunk = chunk_at(file, place.offset, place.length, outline.size)
    if not outline.chunks:
        # A recording declares all its channels before its first message.
        for opcode, body in _declarations(file, chunk):
            _declare(outline, opcode, body)
    outline.chunks.append(chunk)


def _take_damage(outline: Outline, begin: int, end: int) -> None:
    """Note that from one byte to another there is nothing that can be read."""
    length = max(end - begin - RECORD_HEAD.size, 0)
    outline.chunks.append(ChunkPlace(begin, length, 0, 0))


def _mend_times(file: BinaryIO, chunks: list[ChunkPlace]) -> None:
    """Take the times of chunks from their messages, where they are not in the order of the file.

    A chunk's checksum is that of its messages, so its times can be damaged in a sound chunk.
    """
    suspects = {n for n, place in enumerate(chunks) if place.first_ns > place.last_ns}
    for n in range(1, len(chunks)):
        if chunks[n - 1].last_ns > chunks[n].first_ns:
            suspects |= {n - 1, n}
    unknown = set()
    for n in sorted(suspects):
        try:
            times_ns = times_in(unpack_chunk(file, chunks[n]))
        except DamagedChunkError:
            times_ns = None
        if times_ns is None:
            unknown.add(n)
        else:
            chunks[n] = chunks[n]._replace(first_ns=times_ns[0], last_ns=times_ns[1])
    for n in sorted(unknown):
        # What cannot be read lies between its neighbours.
        behind = (chunks[m].first_ns for m in range(n + 1, len(chunks)) if m not in unknown)
        end_ns = next(behind, 0)
        begin_ns = chunks[n - 1].last_ns if n else end_ns
        chunks[n] = chunks[n]._replace(first_ns=begin_ns, last_ns=max(begin_ns, end_ns))


def _declarations(file: BinaryIO, chunk: ChunkPlace) -> Iterator[tuple[int, bytes]]:
    try:
        yield from others_in(unpack_chunk(file, chunk))
    except DamagedChunkError:
        return


def _take_other(outline: Outline, file: BinaryIO, place: _Place) -> None:
    match place.opcode:
        case Opcode.HEADER:
            outline.header = _parse(Header.read, _body(file, place, outline.size))
        case Opcode.ATTACHMENT:
            _take_attachment(outline, file, place)
        case Opcode.METADATA:
            outline.metadata.append(_parse(Metadata.read, _body(file, place, outline.size)))
        case Opcode.SCHEMA | Opcode.CHANNEL:
            _declare(outline, place.opcode, _body(file, place, outline.size))


def _take_attachment(outline: Outline, file: BinaryIO, place: _Place) -> None:
    body = _body(file, place, outline.size)
    try:
        attachment = _parse(Attachment.read, body)
        (checksum,) = _CHECKSUM.unpack(body[-_CHECKSUM.size :])
    except _BROKEN:
        outline.damaged_attachments.append(f"at byte {place.offset:,}")
        return
    if checksum and zlib.crc32(body[: -_CHECKSUM.size]) != checksum:
        outline.damaged_attachments.append(attachment.name)
    outline.attachments.append(attachment)


def _declare(outline: Outline, opcode: int, body: bytes) -> None:
    if opcode == Opcode.SCHEMA:
        schema = _parse(Schema.read, body)
        outline.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = _parse(Channel.read, body)
        outline.channels[channel.id] = channel


def _walk(file: BinaryIO, begin: int, end: int) -> Iterator[_Place]:
    """Yield where the records from one byte to another lie; the last one may reach beyond it."""
    offset = begin
    while offset + RECORD_HEAD.size <= end:
        place = _place_at(file, offset)
        if not 0 < place.opcode <= _LARGEST_OPCODE:
            return  # A disk that lost its power leaves zeros.
        yield place
        offset = place.end


def _place_at(file: BinaryIO, offset: int) -> _Place:
    file.seek(offset)
    opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
    return _Place(opcode, offset, length)


def _body(file: BinaryIO, place: _Place, size: int) -> bytes:
    if place.end > size:
        raise ValueError(f"the record at byte {place.offset} reaches beyond the end of the file")
    file.seek(place.offset + RECORD_HEAD.size)
    return file.read(place.length)


def _parse(read: Callable[[ReadDataStream], R], body: bytes) -> R:
    return read(ReadDataStream(BytesIO(body)))
