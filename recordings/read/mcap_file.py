"""The parts of an MCAP file: what stands beside its messages, and where its chunks lie.

A recording has no index of its messages. Its chunks are found by the lengths of its records,
without unpacking them: in a file that was cut or is still being written as in a whole one. Files
that other programs wrote may have chunks of any packing, or messages outside chunks: these are
read in blocks that count as chunks.

The mcap library makes a Python object of every record; here messages are unpacked where they lie.
That is about ten times faster (`git show 8cd0af41:benchmarks/reading_rate.py` measured it).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Container, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from itertools import takewhile
from os import SEEK_END
from struct import Struct
from typing import BinaryIO, Final, NamedTuple, TypeAlias

import lz4.frame
import zstandard
from mcap import records
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

from bus_schemas.errors import InputError

GOES_ON: Final = "goes_on"
"""Name of the metadata of a file that was full, so that the recording goes on in the next one, and
of an entry in the `run` of that one."""

MAGIC: Final = b"\x89MCAP0\r\n"

MESSAGE_HEAD: Final = Struct("<BQHIQQ")
"""Of a message: opcode, length, channel, sequence number, log time, publish time."""

_RECORD_HEAD: Final = Struct("<BQ")
"""Of every record: opcode, length of what follows."""

_CHANNEL_HEAD: Final = Struct("<BQHHI")
"""Of a channel: opcode, length, number, schema, length of its topic."""

_CHUNK_HEAD: Final = Struct("<QQQII")
"""Of a chunk: first and last log time, size and checksum unpacked, length of the codec's name."""

_PACKED_LENGTH_SIZE: Final = 8
"""Bytes between the codec's name and the packed data."""

_LARGEST_CHUNK: Final = 1 << 26
"""A chunk that unpacks to more bytes is damaged; those of a recording have about 1 MiB."""

_CHUNK_OR_END: Final = re.compile(rb"\x06[\s\S]{36}(?:\x03\0\0\0lz4|\x04\0\0\0zstd)|\x0f\x04\0{7}")
"""The begin of a chunk's record, up to the codec's name, and that of the end of the data."""

_LONGEST_FOUND: Final = 44
_NOWHERE: Final = 1 << 63

_OPCODES: Final = frozenset(Opcode)
_PRIVATE: Final = 0x80
"""Records of this opcode or a higher one are another application's; Heliarch writes none."""

_UNCHUNKED: Final = frozenset({Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA})
_BLOCK: Final = 1 << 20

_BROKEN: Final = (
    *(McapError, struct.error, ValueError, EOFError, RuntimeError, OverflowError, MemoryError),
    zstandard.ZstdError,
)
"""What reading a damaged record can raise."""

RawMessage: TypeAlias = tuple[int, int, int, int, bytes]
"""Channel, sequence number, log time [ns], publish time [ns], payload."""


class DamagedChunkError(ValueError):
    """A chunk is damaged."""


class Chunk(NamedTuple):
    """Where a chunk's record begins, the length of its body, and the number of its file.

    Of records outside chunks: where the first one begins, and their length.
    """

    offset: int
    length: int
    file: int = 0
    is_record: bool = True


@dataclass
class Outline:
    """What a file consists of, in its order; metadata by name, topics of channels by their number.

    It is `closed` if its writer came to the end of the messages, and `whole` if it ends as it
    should. A full one `ended` too, and `goes_on` in a next file. Others were cut, are damaged at
    `readable_end`, or still being written. The checksums of `damaged_attachments` are wrong.

    `library` names the program that wrote the file.

    A recording may go on in further files. Then `closed` and `readable_end` are those of the last
    one, of the number `file`, and it is `whole` if all of them are. Before a file of `breaks`
    messages may be lost.
    """

    ended: bool = False
    goes_on: bool = False
    whole: bool = False
    readable_end: int = len(MAGIC)
    attachments: list[records.Attachment] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    channels: dict[int, str] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    damaged_attachments: list[str] = field(default_factory=list)
    file: int = 0
    breaks: set[int] = field(default_factory=set)
    library: str = ""

    @property
    def closed(self) -> bool:
        return self.ended and not self.goes_on

    @property
    def is_own(self) -> bool:
        """Whether Heliarch has written the file."""
        return self.library.startswith("heliarch")

    @property
    def cut_early(self) -> bool:
        return not self.closed and not self.chunks

    def append(self, other: Outline, *, is_next: bool) -> None:
        """Add a file; `is_next`: none between it and the last one was deleted."""
        self.file += 1
        if not (is_next and self.goes_on and GOES_ON in other.metadata.get("run", {})):
            self.breaks.add(self.file)
        self.chunks += [chunk._replace(file=self.file) for chunk in other.chunks]
        self.channels = self.channels or other.channels
        self.readable_end, self.ended, self.goes_on = other.readable_end, other.ended, other.goes_on
        self.whole &= other.whole


def read_outline(file: BinaryIO, *, chunks: bool = True) -> Outline:
    """Return what an MCAP file consists of, or only what stands before its first chunk.

    An empty file counts as cut.
    """
    file.seek(0)
    magic = file.read(len(MAGIC))
    if not MAGIC.startswith(magic):
        raise InputError(f"{file.name}: not an MCAP file, it begins with {magic!r}")
    outline = Outline()
    walk_on(outline, file, chunks=chunks)
    return outline


def walk_on(outline: Outline, file: BinaryIO, *, chunks: bool = True) -> None:
    """Go from record to record, to the end of the file or to its cut.

    A second call goes on from there, since a file that is being written grows.
    """
    size = file.seek(0, SEEK_END)
    while not outline.ended:
        offset = outline.readable_end
        file.seek(offset)
        head = file.read(_RECORD_HEAD.size)
        if len(head) < _RECORD_HEAD.size:
            return
        opcode, length = _RECORD_HEAD.unpack(head)
        end = offset + _RECORD_HEAD.size + length
        if opcode in {Opcode.CHUNK, *_UNCHUNKED} and not chunks:
            return
        if opcode in _UNCHUNKED and end <= size:
            end = _take_unchunked(outline, file, offset)
            outline.readable_end = end
            continue
        is_private = opcode >= _PRIVATE and not outline.is_own
        if not (opcode in _OPCODES or is_private) or end > size:
            # What lies before the next chunk counts as a damaged one; before none, as cut off.
            end = _next_chunk(file, offset + 1)
            if not chunks or end > size:
                return
            opcode, length = Opcode.CHUNK, end - offset - _RECORD_HEAD.size
        with suppress(*_BROKEN):  # A damaged record still tells where the next one begins.
            _take(outline, file, opcode, length)
        outline.readable_end = end
        if opcode == Opcode.DATA_END:
            outline.ended = True
            outline.whole = _ends_well(file, end, size)


def _take_unchunked(outline: Outline, file: BinaryIO, offset: int) -> int:
    """Let records outside chunks count as a chunk, about a block of them; return where they end."""
    file.seek(offset)
    block = file.read(_BLOCK)
    _, length = _RECORD_HEAD.unpack_from(block)
    if _RECORD_HEAD.size + length > len(block):  # A record longer than a block.
        block += file.read(_RECORD_HEAD.size + length - len(block))
    records_here = takewhile(lambda record: record[0] in _UNCHUNKED, _records_at(block))
    end = max((end for _, _, end in records_here), default=0)
    outline.chunks.append(Chunk(offset, end, outline.file, is_record=False))
    take_channels(outline, block[:end])
    return offset + end


def take_channels(outline: Outline, content: bytes) -> None:
    """Enter the channels among some records; messages are passed over by their lengths."""
    for opcode, begin, _ in _records_at(content):
        if opcode == Opcode.CHANNEL:
            _, _, number, _, topic_length = _CHANNEL_HEAD.unpack_from(content, begin)
            topic_begin = begin + _CHANNEL_HEAD.size
            topic = content[topic_begin : topic_begin + topic_length]
            outline.channels[number] = topic.decode(errors="replace")


def _records_at(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of each whole record among some bytes."""
    begin = 0
    while begin + _RECORD_HEAD.size <= len(content):
        opcode, length = _RECORD_HEAD.unpack_from(content, begin)
        end = begin + _RECORD_HEAD.size + length
        if end > len(content):
            return
        yield opcode, begin, end
        begin = end


def _next_chunk(file: BinaryIO, begin: int) -> int:
    """Return where the next chunk or the end of the data seems to begin; a high number: nowhere."""
    file.seek(begin)
    block = b""
    while more := file.read(_BLOCK):
        begin -= len(block)
        block += more
        if match := _CHUNK_OR_END.search(block):
            return begin + match.start()
        begin += len(block)
        block = block[-_LONGEST_FOUND:]
    return _NOWHERE


def _take(outline: Outline, file: BinaryIO, opcode: int, length: int) -> None:
    offset = outline.readable_end
    if opcode == Opcode.CHUNK:
        chunk = Chunk(offset, length, outline.file)
        outline.chunks.append(chunk)
        if len(outline.chunks) == 1:
            # A recording declares all its channels before its first message.
            take_channels(outline, unpack_chunk(file, chunk))
    elif opcode in {Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA}:
        file.seek(offset)
        content = file.read(_RECORD_HEAD.size + length)
        match next(_records_in(content), None):
            case records.Header() as header:
                outline.library = header.library
            case records.Metadata(name=name) if name == GOES_ON:
                outline.goes_on = True
            case records.Metadata() as entry:
                outline.metadata[entry.name] = entry.metadata
            case records.Attachment() as attachment:
                outline.attachments.append(attachment)
                checksum = int.from_bytes(content[-4:], "little")
                if checksum and zlib.crc32(content[_RECORD_HEAD.size : -4]) != checksum:
                    outline.damaged_attachments.append(attachment.name)


def _records_in(content: bytes) -> Iterator[records.McapRecord]:
    """Yield the records that some bytes hold, up to a damaged one."""
    with suppress(*_BROKEN):  # The library raises at the end, too.
        yield from StreamReader(BytesIO(content), skip_magic=True).records


def _ends_well(file: BinaryIO, begin: int, size: int) -> bool:
    """Whether the summary that begins behind the messages has its checksum, if any, and its end."""
    file.seek(begin)
    checksum, left = 0, size - begin - 4 - len(MAGIC)
    while left > 0 and (block := file.read(min(left, _BLOCK))):
        checksum = zlib.crc32(block, checksum)
        left -= len(block)
    end = file.read()
    return end in {checksum.to_bytes(4, "little") + MAGIC, bytes(4) + MAGIC}


def unpack_chunk(file: BinaryIO, chunk: Chunk) -> bytes:
    """Return the records in a chunk. Raises DamagedChunkError: It is damaged."""
    if not chunk.is_record:
        file.seek(chunk.offset)
        return file.read(chunk.length)
    file.seek(chunk.offset + _RECORD_HEAD.size)
    body = file.read(chunk.length)
    try:
        *_, size, checksum, name_length = _CHUNK_HEAD.unpack_from(body)
        name = body[_CHUNK_HEAD.size :][:name_length]
        if size > _LARGEST_CHUNK:
            raise ValueError("it unpacks to more than a recorder writes")
        packed = memoryview(body)[_CHUNK_HEAD.size + name_length + _PACKED_LENGTH_SIZE :]
        content = _unpacked(name, packed, size)
        if len(content) != size or (checksum and zlib.crc32(content) != checksum):
            raise ValueError("its checksum or its length is wrong")
    except _BROKEN as reason:
        raise DamagedChunkError(f"it does not unpack ({reason})") from None
    return content


def _unpacked(packing: bytes, packed: memoryview, size: int) -> bytes:
    """Unpack at most `size` bytes."""
    match packing:
        case b"lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size))
        case b"zstd":
            return zstandard.ZstdDecompressor().stream_reader(packed).read(size)
        case b"":
            return bytes(packed)
    raise ValueError(f"expected lz4, zstd or no packing, got {packing[:20]!r}")


def messages_in(content: bytes, channels: Container[int]) -> Iterator[RawMessage]:
    """Yield the messages of some channels among a chunk's records, in the order of the file.

    An incomplete message ends the reading.
    """
    head, end = MESSAGE_HEAD, len(content)
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


def message_records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the whole records of messages, each with its log time [ns]."""
    for opcode, begin, end in _records_at(content):
        if opcode == Opcode.MESSAGE:
            *_, log_time_ns, _ = MESSAGE_HEAD.unpack_from(content, begin)
            yield log_time_ns, content[begin:end]
