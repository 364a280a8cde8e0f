"""Messages are taken out of chunks in bulk just as the library takes them out one by one."""

from __future__ import annotations

from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from recordings.read.chunks import RawMessage, messages_in, unpack_chunk
from recordings.read.outline import read_outline


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


def test_the_messages_of_all_chunks_are_found(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4, chunk_size=300)
        writer.start()
        schema = writer.register_schema("Any", "", b"")
        channels = [writer.register_channel(f"topic/{n}", "msgpack", schema) for n in range(3)]
        for number in range(50):
            payload = bytes([number]) * (number % 11)
            writer.add_message(channels[number % 3], 1000 + number, payload, 900, number)
        writer.finish()
    assert len(by_us(path)) == 50
    assert by_us(path) == by_the_library(path)
