"""The parts of an MCAP file, found by its index or by walking from record to record.

A file that was cut has no index. Its chunks are found by their lengths, without unpacking them, so
a cut recording is read like a whole one, up to the cut.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from os import SEEK_END
from struct import Struct
from typing import BinaryIO, Final, NamedTuple

from mcap import records
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

from bus_schemas.errors import InputError
from recordings.read.chunks import BROKEN, RECORD_HEAD, ChunkPlace, chunk_at, unpack_chunk

MAGIC: Final = b"\x89MCAP0\r\n"
_FOOTER: Final = Struct("<BQQQI")
"""The footer: opcode, length, begin of the index, begin of its offsets, checksum of the index."""

_CHUNK_INDEX: Final = Struct("<QQQQ")
"""In the index of a chunk: its first and last log time, where it begins, length of its record."""

_OPCODES: Final = frozenset(Opcode)
_BLOCK: Final = 1 << 20


class _Place(NamedTuple):
    """Where a record lies: its first byte, and the length of its body."""

    opcode: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        """The first byte behind the record."""
        return self.offset + RECORD_HEAD.size + self.length


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
    readable_end: int = len(MAGIC)
    header: records.Header | None = None
    attachments: list[records.Attachment] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    damaged_attachments: list[str] = field(default_factory=list)
    file: int = 0

    @property
    def cut_early(self) -> bool:
        return not self.closed and not self.chunks

    def go_on(self, other: Outline) -> None:
        """Go on with the outline of a further file."""
        self.file += 1
        self.chunks += [place._replace(file=self.file) for place in other.chunks]
        self.channels = self.channels or other.channels
        self.size, self.readable_end, self.closed = other.size, other.readable_end, other.closed
        self.indexed &= other.indexed


def read_outline(file: BinaryIO) -> Outline:
    """Return what an MCAP file consists of. An empty file counts as cut."""
    size = file.seek(0, SEEK_END)
    file.seek(0)
    magic = file.read(len(MAGIC))
    if not MAGIC.startswith(magic):
        raise InputError(f"{file.name}: not an MCAP file, it begins with {magic!r}")
    with suppress(*BROKEN):  # The file was cut, or its index is damaged.
        return _by_index(file, size)
    outline = Outline(size=0)
    walk_on(outline, file)
    return outline


def _by_index(file: BinaryIO, size: int) -> Outline:
    """Read the index at the end of a file, if it has a sound one."""
    end = size - _FOOTER.size - len(MAGIC)
    file.seek(max(end, 0))
    tail = file.read()
    opcode, _, begin, _, checksum = _FOOTER.unpack_from(tail)
    if not tail.endswith(MAGIC) or opcode != Opcode.FOOTER or not begin:
        raise ValueError("no index")
    if _checksum(file, begin, size - len(MAGIC) - 4) != checksum:
        raise ValueError("a damaged index")
    outline = Outline(size, closed=True, indexed=True, readable_end=begin)
    elsewhere = [len(MAGIC)]  # Where the header, attachments and metadata lie.
    for place in _walk(file, begin, end):
        content = _content(file, place, size)
        if place.opcode == Opcode.CHUNK_INDEX:
            # The library would make a dictionary of channels for each of 170,000 chunks a day.
            first_ns, last_ns, offset, length = _CHUNK_INDEX.unpack_from(content, RECORD_HEAD.size)
            chunk = ChunkPlace(offset, length - RECORD_HEAD.size, first_ns, last_ns)
            outline.chunks.append(chunk)
            continue
        for entry in _records_in(content):
            if isinstance(entry, records.AttachmentIndex | records.MetadataIndex):
                elsewhere.append(entry.offset)
            _enter(outline, entry)
    for offset in elsewhere:
        _take(outline, file, _place_at(file, offset))
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
    for place in _walk(file, outline.readable_end, size):
        if place.end > size:
            break
        with suppress(*BROKEN):  # A damaged record still tells where the next one begins.
            _take(outline, file, place)
        outline.readable_end = place.end
        if place.opcode == Opcode.DATA_END:
            outline.closed = True
            break


def _take(outline: Outline, file: BinaryIO, place: _Place) -> None:
    """Enter a record of the data section into the outline."""
    if place.opcode == Opcode.CHUNK:
        chunk = chunk_at(file, place.offset, place.length)._replace(file=outline.file)
        outline.chunks.append(chunk)
        if len(outline.chunks) == 1:
            # A recording declares all its channels before its first message.
            for entry in _records_in(unpack_chunk(file, chunk)):
                _enter(outline, entry)
    elif place.opcode in {Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA}:
        content = _content(file, place, outline.size)
        record = next(_records_in(content), None)
        if record is None:
            raise ValueError(f"the record at byte {place.offset} is damaged")
        _enter(outline, record)
        body, checksum = content[RECORD_HEAD.size : -4], int.from_bytes(content[-4:], "little")
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
    with suppress(*BROKEN):  # The library raises at the end, too.
        yield from StreamReader(BytesIO(content), skip_magic=True).records


def _walk(file: BinaryIO, begin: int, end: int) -> Iterator[_Place]:
    """Yield where the records from one byte to another lie; the last one may reach beyond it."""
    offset = begin
    while offset + RECORD_HEAD.size <= end:
        place = _place_at(file, offset)
        if place.opcode not in _OPCODES:
            return  # A disk that lost its power leaves zeros.
        yield place
        offset = place.end


def _place_at(file: BinaryIO, offset: int) -> _Place:
    file.seek(offset)
    opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
    return _Place(opcode, offset, length)


def _content(file: BinaryIO, place: _Place, size: int) -> bytes:
    """Return a record as it is in the file."""
    if place.end > size:
        raise ValueError(f"the record at byte {place.offset} reaches beyond the end of the file")
    file.seek(place.offset)
    return file.read(place.end - place.offset)
