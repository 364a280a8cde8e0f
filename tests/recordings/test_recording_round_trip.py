"""What is written into a recording is what is read from it, by this project and by others."""

from __future__ import annotations

import json
from pathlib import Path

import msgpack
import msgspec
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from recordings_by_hand import PLAN, whole_run, write_run

from bus_schemas.bus import Delivery
from bus_schemas.codec import json_schema
from bus_schemas.errors import InputError
from bus_schemas.signals import ports
from recordings.read.reader import RunReader
from recordings.read.run_file import SCHEMA_VERSION, NothingRecordedError

Recording = tuple[Path, list[Delivery]]
"""A file, and what was written into it."""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    return path, write_run(path, whole_run(2))


# Read by others -----------------------------------------------------------------------------------


def test_the_mcap_library_reads_the_same_messages_all_and_by_topic(
    written: Recording,
) -> None:
    path, deliveries = written
    with path.open("rb") as file:
        reader = make_reader(file)
        anchor = {entry.name: entry.metadata for entry in reader.iter_metadata()}["clock_anchor"]
        found = [(channel.topic, record) for _, channel, record in reader.iter_messages()]
        for topic in {topic for topic, _ in found}:
            by_topic = [record for _, _, record in reader.iter_messages(topics=topic)]
            assert by_topic == [record for other, record in found if other == topic]
    to_wall_ns = int(anchor["wall_ns"]) - int(anchor["monotonic_ns"])
    assert [
        (topic, record.sequence, record.publish_time, msgpack.unpackb(record.data))
        for topic, record in found
    ] == [
        (
            f"field/{port}",
            message.sequence,
            message.publish_time_ns + to_wall_ns,
            msgspec.json.decode(msgspec.json.encode(message)),
        )
        for port, message in deliveries
    ]
    assert all(record.publish_time <= record.log_time for _, record in found)


def test_channels_are_the_ports_of_the_run_with_their_schemas(written: Recording) -> None:
    with written[0].open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    channels = {channel.topic: channel for channel in summary.channels.values()}
    logged = [port for port in ports(PLAN.tree) if port.signal.logged]
    assert channels.keys() == {f"field/{port}" for port in logged}
    for port in logged:
        channel = channels[f"field/{port}"]
        schema = summary.schemas[channel.schema_id]
        assert channel.metadata == {"signal": port.signal.name, "node": port.node}
        assert (channel.message_encoding, schema.encoding) == ("msgpack", "jsonschema")
        assert schema.name == port.signal.type.__name__
        assert json.loads(schema.data) == json.loads(json.dumps(json_schema(port.signal)))


# No recording of a run ----------------------------------------------------------------------------


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        RunReader(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def mcap_file(path: Path, *attached: str, **metadata: str) -> Path:
    """An MCAP file without messages, with attachments that say nothing."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        if metadata:
            writer.add_metadata("run", metadata)
        for name in attached:
            writer.add_attachment(0, 0, name, "application/octet-stream", b"{}")
        writer.finish()
    return path


@pytest.mark.parametrize("content", [b"inverter,lat,lon\na,1,2\n" * 20, b"\x89MCAP1\r\n", b"short"])
def test_a_file_that_is_no_mcap_is_refused_with_what_it_is(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    assert repr(content[:8]) in refused(path)


@pytest.mark.parametrize("content", [b"", *(b"\x89MCAP0\r\n" + rest for rest in (b"", bytes(500)))])
def test_a_file_that_was_cut_before_its_plan_holds_nothing(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(NothingRecordedError):
        RunReader(path)


@pytest.mark.parametrize(
    ("attached", "version", "named"),
    [
        ("", SCHEMA_VERSION, "plan.json"),
        ("scenario.toml", SCHEMA_VERSION, "plan.json"),
        ("plan.json", SCHEMA_VERSION, "run_id"),
        ("", None, "no recording"),
        ("", "2", f"version 2, this Heliarch reads version {SCHEMA_VERSION}"),
        ("", "99", f"version 99, this Heliarch reads version {SCHEMA_VERSION}"),
    ],
    ids=["no plan", "no plan beside a scenario", "no plan in it", "another project", "old", "new"],
)
def test_an_mcap_file_that_is_no_recording_of_this_version_is_refused(
    tmp_path: Path, attached: str, version: str | None, named: str
) -> None:
    metadata = {} if version is None else {"schema_version": version}
    assert named in refused(mcap_file(tmp_path / "run.mcap", *attached.split(), **metadata))
