"""What is written into a recording is what is read from it, by this project and by others."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import msgpack
import msgspec
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from agents.plan import RunPlan, load_plan
from bus_schemas.bus import Delivery, Outbox
from bus_schemas.codec import encode, json_schema
from bus_schemas.errors import InputError
from bus_schemas.messages import Help, HelpGiven, Impp, Residual, Run, Setpoint
from bus_schemas.signals import HELP, IMPP, RESIDUAL, RUN, SETPOINT, SIGNALS, ports
from bus_schemas.tree import ROOT
from recordings.read.reader import NothingRecordedError, RunReader
from recordings.read.run_file import SCHEMA_VERSION
from recordings.record.writer import ClockAnchor, RunWriter

PLAN = RunPlan(
    run_id="by-hand-1",
    plant="oahu",
    inverters=(("c1/a", 100.0), ("c1/b", 100.0)),
    start_time_ns=1_270_159_200_000_000_000,
    cycle_ns=1_000_000_000,
    cycles=2,
    timezone="UTC",
    regulation_capacity_kw=0.0,
    cycle_wall_ns=0,
    period_cycles=(1, 1),
    scheme="paper",
    actuator="fraction",
    alpha_min=0.05,
    hold_cycles=3,
    stall_timeout_s=3.0,
    neighbourhoods=(),
    tcp_ports={},
)
SCENARIO = 'name = "oahu"\n# Wörter\n'


def said() -> Iterator[Delivery]:
    """A few messages of two cycles."""
    start_time_ns = PLAN.start_time_ns
    yield (
        RUN.of(ROOT),
        Run(0, start_time_ns, "plant", (), state="start", start_time_ns=1, cycle_wall_ns=0),
    )
    for cycle in range(2):
        for node in ("c1/a", "c1/b"):
            stamp = (cycle, PLAN.sim_time_ns(cycle), node, ())
            yield IMPP.of(node), Impp(*stamp, power_kw=100 / 3, stale_cycles=cycle)
            yield RESIDUAL.of(node), Residual(*stamp, power_kw=-16.7)
            yield HELP.of(node), Help(*stamp, missing_kw=16.7)
        yield (
            SETPOINT.of("c1/a"),
            Setpoint(
                cycle,
                PLAN.sim_time_ns(cycle),
                "c1",
                ("c1/b/impp",),
                power_kw=60.0,
                share_kw=50.0,
                help_given=(HelpGiven("c1/b", 10.0),),
            ),
        )


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Delivery]]:
    """A recording, and what was written into it."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    outbox = Outbox()
    writer = RunWriter(path, PLAN, SCENARIO, driver="simulate")
    deliveries = []
    for port, message in said():
        outbox.stamp(port, message, time.monotonic_ns())
        writer.add(port, message, encode(message), time.monotonic_ns())
        deliveries.append((port, message))
    writer.flush()
    writer.close()
    assert writer.recorded == outbox.published
    return path, deliveries


# Read by this project -----------------------------------------------------------------------------


def test_what_is_written_is_read_back(written: tuple[Path, list[Delivery]]) -> None:
    path, deliveries = written
    with RunReader(path) as reader:
        assert list(reader.messages()) == deliveries


def test_a_run_can_be_named_by_its_folder(written: tuple[Path, list[Delivery]]) -> None:
    path, _ = written
    with RunReader(path.parent) as reader:
        assert reader.path == path
        assert reader.plan.run_id == "by-hand-1"


def test_a_recording_knows_its_plan_and_its_scenario(
    written: tuple[Path, list[Delivery]],
) -> None:
    with RunReader(written[0]) as reader:
        assert reader.plan == PLAN
        assert reader.scenario == SCENARIO


# Read by others -----------------------------------------------------------------------------------


def test_anybodys_reader_and_anybodys_msgpack_find_the_same(
    written: tuple[Path, list[Delivery]],
) -> None:
    path, deliveries = written
    with path.open("rb") as file:
        found = [
            (channel.topic, msgpack.unpackb(record.data))
            for _, channel, record in make_reader(file).iter_messages()
        ]
    assert found == [
        (f"oahu/{port}", msgspec.json.decode(msgspec.json.encode(message)))
        for port, message in deliveries
    ]


def test_sequence_and_times_are_those_of_the_bus(written: tuple[Path, list[Delivery]]) -> None:
    path, deliveries = written
    with path.open("rb") as file:
        reader = make_reader(file)
        anchor = {entry.name: entry.metadata for entry in reader.iter_metadata()}["clock_anchor"]
        records = [record for _, _, record in reader.iter_messages()]
    to_wall_ns = int(anchor["wall_ns"]) - int(anchor["monotonic_ns"])
    assert [record.sequence for record in records] == [
        message.sequence for _, message in deliveries
    ]
    assert {record.sequence for record in records} == {0, 1}
    assert [record.publish_time for record in records] == [
        message.publish_time_ns + to_wall_ns for _, message in deliveries
    ]
    assert all(record.publish_time <= record.log_time for record in records)


def test_channels_are_the_ports_of_the_run_with_their_schemas(
    written: tuple[Path, list[Delivery]],
) -> None:
    path, _ = written
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    channels = {
        channel.topic: (
            channel.message_encoding,
            summary.schemas[channel.schema_id].name,
            channel.metadata,
        )
        for channel in summary.channels.values()
    }
    assert channels == {
        f"oahu/{port}": (
            "msgpack",
            port.signal.type.__name__,
            {"signal": port.signal.name, "node": port.node},
        )
        for port in ports(PLAN.tree)
        if port.signal.logged
    }


def test_schemas_describe_the_messages(written: tuple[Path, list[Delivery]]) -> None:
    path, _ = written
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    found = {
        schema.name: (schema.encoding, json.loads(schema.data))
        for schema in summary.schemas.values()
    }
    expected = {
        signal.type.__name__: ("jsonschema", json.loads(json.dumps(json_schema(signal))))
        for signal in SIGNALS
        if signal.logged
    }
    assert found == expected


def test_metadata_and_attachments_tell_where_a_recording_comes_from(
    written: tuple[Path, list[Delivery]], tmp_path: Path
) -> None:
    with written[0].open("rb") as file:
        reader = make_reader(file)
        run = {entry.name: entry.metadata for entry in reader.iter_metadata()}["run"]
        attachments = {entry.name: entry for entry in reader.iter_attachments()}
    assert (run["run_id"], run["plant"], run["driver"]) == ("by-hand-1", "oahu", "simulate")
    assert run["schema_version"] == SCHEMA_VERSION
    assert {"python", "version heliarch", "version mcap"} <= set(run)
    assert attachments["scenario.toml"].media_type == "application/toml"
    assert attachments["scenario.toml"].data.decode() == SCENARIO
    plan_json = tmp_path / "plan.json"
    plan_json.write_bytes(attachments["plan.json"].data)
    assert load_plan(plan_json) == PLAN


def test_an_anchor_turns_one_clock_into_the_other() -> None:
    anchor = ClockAnchor(monotonic_ns=500, wall_ns=1_000_000)
    assert [anchor.wall(monotonic_ns) for monotonic_ns in (500, 501, 400)] == [
        1_000_000,
        1_000_001,
        999_900,
    ]


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


def test_a_recording_that_is_not_there_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / "x.mcap")
    with pytest.raises(InputError, match=r"run\.mcap"):
        RunReader(tmp_path)


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
    ("attached", "named"),
    [
        ((), "scenario.toml"),
        (("scenario.toml",), "plan.json"),
        (("scenario.toml", "plan.json"), "run_id"),
    ],
)
def test_a_recording_without_its_plan_is_refused(
    tmp_path: Path, attached: tuple[str, ...], named: str
) -> None:
    path = mcap_file(tmp_path / "run.mcap", *attached, schema_version=SCHEMA_VERSION)
    assert named in refused(path)


def test_the_mcap_file_of_another_project_is_refused(tmp_path: Path) -> None:
    assert "no recording" in refused(mcap_file(tmp_path / "robot.mcap"))


@pytest.mark.parametrize("found", ["2", "99"])
def test_a_recording_of_another_version_is_refused(tmp_path: Path, found: str) -> None:
    message = refused(mcap_file(tmp_path / "run.mcap", schema_version=found))
    assert found in message
    assert SCHEMA_VERSION in message
