"""Recordings that another program has written anew: whatever holds the messages is read."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import pytest
from command_line import done, refusal
from mcap.reader import McapReader, make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType, IndexType, Writer
from recordings_by_hand import whole_run, write_run

from recordings.inspect.overview import read_overview
from recordings.read.reader import RunReader

CYCLES = 40
BARE = {
    "index_types": IndexType.NONE,
    "use_statistics": False,
    "use_summary_offsets": False,
    "repeat_channels": False,
    "repeat_schemas": False,
}


Entry: TypeAlias = tuple[Schema | None, Channel, Message]
Order: TypeAlias = Callable[[Entry], str | float | tuple[str, int]]


def by_time(entry: Entry) -> int:
    return int(entry[2].log_time)


def by_topic(entry: Entry) -> tuple[str, int]:
    return entry[1].topic, by_time(entry)


def shuffled(entry: Entry) -> float:
    return random.Random(by_time(entry)).random()


class Another(Writer):
    """Another program's writer, with channels of its own numbers."""

    def __init__(self, file: BinaryIO, **options: Any) -> None:
        super().__init__(file, **options)
        self.start(profile="", library="another program")
        self._channels: dict[str, int] = {}

    def attach(self, reader: McapReader) -> None:
        for one in reader.iter_attachments():
            self.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        for entry in reader.iter_metadata():
            self.add_metadata(entry.name, entry.metadata)

    def forget(self) -> None:
        """Declare each schema and each channel again, by new numbers, as merged files do."""
        self._channels.clear()

    def finish(self) -> None:
        Writer.finish(self)

    def channel(self, entry: Entry) -> int:
        schema, channel, _ = entry
        assert schema is not None
        if channel.topic not in self._channels:
            number = self.register_schema(schema.name, schema.encoding, schema.data)
            self._channels[channel.topic] = self.register_channel(
                channel.topic, channel.message_encoding, number
            )
        return self._channels[channel.topic]


def rewrite(
    recording: Path,
    to: Path,
    *,
    order: Order = by_time,
    attachments_last: bool = False,
    is_late_declared: bool = False,
    declared_again_after: int = 0,
    **options: Any,
) -> None:
    """Write a recording as another program would: with the mcap library, in an order."""
    with recording.open("rb") as source, to.open("wb") as file:
        reader, writer = make_reader(source), Another(file, **options)
        entries = sorted(reader.iter_messages(), key=order)
        if not attachments_last:
            writer.attach(reader)
        if not is_late_declared:
            for entry in reversed(entries):
                writer.channel(entry)
        for number, entry in enumerate(entries):
            if declared_again_after and number % declared_again_after == 0:
                writer.forget()
            one = entry[2]
            writer.add_message(
                writer.channel(entry), one.log_time, one.data, one.publish_time, one.sequence
            )
        if attachments_last:
            writer.attach(reader)
        writer.finish()


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    write_run(tmp_path / "run.mcap", whole_run(CYCLES))
    return tmp_path / "run.mcap"


WAYS: dict[str, dict[str, Any]] = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 20_000},
    "not packed": {"compression": CompressionType.NONE},
    "no chunks": {"use_chunking": False},
    "no chunks, no summary": {"use_chunking": False, **BARE},
    "no index, no summary": {"compression": CompressionType.ZSTD, **BARE},
    "by topic": {"order": by_topic, "chunk_size": 20_000},
    "shuffled, no chunks": {"order": shuffled, "use_chunking": False},
    "attachments last": {"attachments_last": True, "chunk_size": 20_000},
    "attachments last, no chunks": {"attachments_last": True, "use_chunking": False},
    "channels as they come": {"is_late_declared": True, "chunk_size": 4000, **BARE},
    "schemas and channels again": {"declared_again_after": 500, "chunk_size": 20_000},
    "schemas and channels again, no chunks": {"declared_again_after": 500, "use_chunking": False},
    "no checksums": {"enable_crcs": False, "enable_data_crcs": False},
}


@pytest.mark.parametrize("way", WAYS)
def test_recordings_of_other_programs_are_read(recording: Path, tmp_path: Path, way: str) -> None:
    other = tmp_path / "other" / "run.mcap"
    other.parent.mkdir()
    rewrite(recording, other, **WAYS[way])
    with RunReader(recording) as run, RunReader(other) as found:
        expected, overview = read_overview(run), read_overview(found)
        assert (overview.signals, overview.whole) == (expected.signals, True)
        assert overview.states == expected.states
        wanted, same = (
            one.frames("impp", nodes="c1/a", start=20, end=25)["impp"] for one in (run, found)
        )
        assert same.equals(wanted)


@pytest.mark.parametrize("way", ["zstd", "no chunks", "by topic"])
def test_recordings_of_other_programs_are_verified_and_exported(
    plant: str, tmp_path: Path, way: str
) -> None:
    done("simulate", plant, "--duration", "20", "--out", tmp_path / "run")
    other = tmp_path / "other"
    other.mkdir()
    (other / "profile.npz").write_bytes((tmp_path / "run" / "profile.npz").read_bytes())
    rewrite(tmp_path / "run" / "run.mcap", other / "run.mcap", **WAYS[way])
    assert "equal" in done("verify", other)
    done("export", other, "--format", "mcap", "--out", tmp_path / "again.mcap")
    with RunReader(tmp_path / "again.mcap") as run:
        assert read_overview(run).complete_cycles == 20


def test_a_cut_file_without_chunks_is_read_up_to_the_cut(recording: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    rewrite(recording, other, use_chunking=False)
    content = other.read_bytes()
    other.write_bytes(content[: len(content) * 2 // 3])
    with RunReader(other) as run:
        overview = read_overview(run)
        assert 0 < overview.complete_cycles < CYCLES
        assert not overview.whole


def test_a_recording_with_messages_of_no_key_of_its_plan_is_refused(
    recording: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.mcap"
    with recording.open("rb") as source, other.open("wb") as file:
        writer = Another(file)
        writer.attach(make_reader(source))
        channel = writer.register_channel("elsewhere/temperature", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    assert "expected messages of a heliarch run" in refusal("inspect", other)
