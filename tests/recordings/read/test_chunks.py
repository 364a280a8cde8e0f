"""Messages are taken out of chunks in bulk just as the library takes them out one by one."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from recordings_by_hand import whole_run, write_run

from recordings.read.chunks import (
    DamagedChunkError,
    RawMessage,
    find_chunk,
    is_chunk,
    messages_in,
    others_in,
    unpack_chunk,
)
from recordings.read.outline import Outline, read_outline


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("chunks") / "run.mcap"
    write_run(path, whole_run(30))
    return path


def by_us(path: Path) -> list[RawMessage]:
    with path.open("rb") as file:
        outline = read_outline(file)
        return [
            raw
            for place in outline.chunks
            for raw in messages_in(unpack_chunk(file, place), outline.channels)
        ]


def by_the_library(path: Path) -> list[RawMessage]:
    with path.open("rb") as file:
        return [
            (m.channel_id, m.sequence, m.log_time, m.publish_time, m.data)
            for _, _, m in make_reader(file).iter_messages(log_time_order=False)
        ]


def test_messages_are_those_that_the_library_finds(recording: Path) -> None:
    found = by_us(recording)
    assert len(found) > 500
    assert found == by_the_library(recording)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_compression_of_mcap_is_unpacked(
    tmp_path: Path, compression: CompressionType
) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, chunk_size=300)
        writer.start()
        schema = writer.register_schema("Any", "", b"")
        channels = [writer.register_channel(f"topic/{n}", "msgpack", schema) for n in range(3)]
        for number in range(50):
            payload = bytes([number]) * (number % 11)
            writer.add_message(channels[number % 3], 1000 + number, payload, 900, number)
        writer.finish()
    assert len(by_us(path)) == 50
    assert by_us(path) == by_the_library(path)


def test_channels_that_nobody_asked_for_are_left_out(recording: Path) -> None:
    with recording.open("rb") as file:
        outline = read_outline(file)
        records = unpack_chunk(file, outline.chunks[2])
    wanted = {raw[0] for raw in messages_in(records, outline.channels) if raw[0] % 2}
    assert wanted
    assert list(messages_in(records, wanted)) == [
        raw for raw in messages_in(records, outline.channels) if raw[0] in wanted
    ]


def test_schemas_and_channels_stand_in_the_first_chunk(recording: Path) -> None:
    with recording.open("rb") as file:
        outline = read_outline(file)
        first, second = (unpack_chunk(file, place) for place in outline.chunks[:2])
    assert len(list(others_in(first))) == len(outline.schemas) + len(outline.channels)
    assert list(others_in(second)) == []


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0.0, 1.0))
def test_records_cut_anywhere_yield_the_whole_messages_before_the_cut(
    recording: Path, share: float
) -> None:
    with recording.open("rb") as file:
        outline = read_outline(file)
        records = unpack_chunk(file, outline.chunks[1])
    whole = list(messages_in(records, outline.channels))
    cut = list(messages_in(records[: int(share * len(records))], outline.channels))
    assert cut == whole[: len(cut)]
    assert len(cut) >= int(share * len(whole)) - 2


def damaged(path: Path, at: int) -> tuple[Path, Outline]:
    content = bytearray(path.read_bytes())
    with path.open("rb") as file:
        outline = read_outline(file)
    content[outline.chunks[1].offset + at] ^= 0xFF
    other = path.with_name(f"damaged-{at}.mcap")
    other.write_bytes(content)
    return other, outline


@pytest.mark.parametrize(("at", "reason"), [(60, "unpack"), (500, "checksum|unpack")])
def test_a_chunk_that_is_not_what_was_written_is_refused(
    recording: Path, at: int, reason: str
) -> None:
    path, outline = damaged(recording, at)
    with path.open("rb") as file, pytest.raises(DamagedChunkError, match=reason):
        unpack_chunk(file, outline.chunks[1])


@pytest.mark.parametrize("zeroed", [20, 49, 4096, None])
def test_a_chunk_that_is_zeroed_is_refused_and_not_empty(
    recording: Path, tmp_path: Path, zeroed: int | None
) -> None:
    content = bytearray(recording.read_bytes())
    with recording.open("rb") as file:
        place = read_outline(file).chunks[1]
    length = min(zeroed or place.length, place.length)
    content[place.offset : place.offset + length] = bytes(length)
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with path.open("rb") as file, pytest.raises(DamagedChunkError, match="no chunk begins there"):
        unpack_chunk(file, place)


def without_checksums(path: Path) -> Outline:
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
        writer.start()
        channel = writer.register_channel("topic", "msgpack", writer.register_schema("A", "", b""))
        for number in range(20):
            writer.add_message(channel, 1000 + number, bytes(10), 900, number)
        writer.finish()
    with path.open("rb") as file:
        return read_outline(file)


@pytest.mark.parametrize(
    ("opcode", "length", "reason"),
    [(0, 0, "a record in it is none"), (5, 5000, "reaches beyond its end")],
)
def test_without_a_checksum_the_records_still_have_to_be_a_row(
    tmp_path: Path, opcode: int, length: int, reason: str
) -> None:
    path = tmp_path / "other.mcap"
    (place,) = without_checksums(path).chunks
    content = bytearray(path.read_bytes())
    with path.open("rb") as file:
        assert len(list(messages_in(unpack_chunk(file, place), {1}))) == 20
    last_message = place.offset + 9 + place.length - (31 + 10)
    content[last_message : last_message + 9] = bytes([opcode]) + length.to_bytes(8, "little")
    path.write_bytes(content)
    with path.open("rb") as file, pytest.raises(DamagedChunkError, match=reason):
        unpack_chunk(file, place)


def test_a_chunk_that_unpacks_to_another_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    (place,) = without_checksums(path).chunks
    content = bytearray(path.read_bytes())
    content[place.offset + 9 + 16] ^= 1
    path.write_bytes(content)
    with path.open("rb") as file, pytest.raises(DamagedChunkError, match="bytes unpack of it"):
        unpack_chunk(file, place)


def test_chunks_are_found_again_from_anywhere(recording: Path) -> None:
    with recording.open("rb") as file:
        outline = read_outline(file)
        offsets = [place.offset for place in outline.chunks]
        assert all(is_chunk(file, offset) for offset in offsets)
        for before, behind in pairwise(offsets):
            assert find_chunk(file, before, outline.size) == before
            assert find_chunk(file, before + 1, outline.size) == behind
        assert find_chunk(file, offsets[-1] + 1, outline.size) is None
