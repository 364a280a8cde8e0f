"""What an export for viewers holds, read by the mcap library, json and jsonschema alone."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.records import Message as McapMessage
from plans_by_hand import with_changes
from recording_by_hand import PLAN, written

from bus_schemas.signals import DISPATCH, RESIDUAL, SIGNALS, Signal
from recordings.export.exporting import export
from recordings.export.foxglove import layout
from recordings.export.mcap_copies import Clock, ViewerFile, object_schema
from recordings.read.reader import RunReader
from recordings.read.run_file import recorded_ports

RECORDED = tuple(signal for signal in SIGNALS if signal.logged)

PLAIN = {"boolean", "string", "number", "integer"}


class Entry(NamedTuple):
    """A message as the mcap library gives it."""

    schema: Schema
    channel: Channel
    message: McapMessage


def entries(path: Path) -> Iterator[Entry]:
    """Messages of an MCAP file, in the order of the file."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            yield Entry(schema, channel, message)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    assert written(path)
    return path


def viewer_file(run: Path, clock: Clock = "wall") -> Path:
    """Export a recording; return the file."""
    path = run.with_name("viewers.mcap")
    with RunReader(run) as reader, ViewerFile(path, reader, reader.ports(), clock) as file:
        for record in reader.records():
            file.add(record, record.message())
    return path


def said(payload: bytes) -> dict[str, Any]:
    """What a payload on the wire says, as JSON would say it."""
    fields: dict[str, Any] = msgpack.unpackb(payload)
    if "help_given" in fields:
        names = ("needy", "power_kw")
        fields["help_given"] = [
            finite(dict(zip(names, line, strict=True))) for line in fields["help_given"]
        ]
    return finite(fields)


def finite(fields: dict[str, Any]) -> dict[str, Any]:
    """Leave out what JSON cannot hold, and what is nil."""
    return {name: value for name, value in fields.items() if value is not None and holds(value)}


def holds(value: object) -> bool:
    if isinstance(value, list):
        return all(map(holds, value))
    return not isinstance(value, float) or isfinite(value)


def test_each_message_is_there_with_its_times_and_is_json_as_its_schema_says(run: Path) -> None:
    path = viewer_file(run)
    validators: dict[str, Draft202012Validator] = {}
    for before, after in zip(entries(run), entries(path), strict=True):
        assert after.channel.topic == before.channel.topic
        assert after.channel.metadata == before.channel.metadata
        assert after.schema.name == before.schema.name
        assert after.message.log_time == before.message.log_time
        assert after.message.publish_time == before.message.publish_time
        assert after.message.sequence == before.message.sequence
        fields = json.loads(after.message.data)
        assert fields == said(before.message.data)
        assert (after.schema.encoding, after.channel.message_encoding) == ("jsonschema", "json")
        if after.schema.name not in validators:
            document = json.loads(after.schema.data)
            Draft202012Validator.check_schema(document)
            validators[after.schema.name] = Draft202012Validator(document)
        validators[after.schema.name].validate(fields)
    assert validators.keys() == {signal.type.__name__ for signal in RECORDED} - {
        "Order",
        "Offer",
    }


@pytest.mark.parametrize("signal", RECORDED, ids=[signal.name for signal in RECORDED])
def test_viewers_understand_the_schema(signal: Signal[Any]) -> None:
    """One type a property: plain, or an array of objects or of plain ones. No references."""
    unread = [object_schema(signal)]
    while unread:
        schema: Any = unread.pop()
        assert schema["type"] == "object"
        for name, entry in schema["properties"].items():
            item = entry["items"] if entry["type"] == "array" else entry
            if item["type"] == "object":
                unread.append(item)
            else:
                assert item["type"] in PLAIN, name


def test_a_viewer_may_show_simulated_time(run: Path) -> None:
    path = viewer_file(run, clock="sim")
    for entry in entries(path):
        time_ns = json.loads(entry.message.data)["sim_time_ns"]
        assert entry.message.log_time == entry.message.publish_time == time_ns


@pytest.mark.parametrize("signals", [(), (DISPATCH,), (RESIDUAL,)])
def test_what_the_layout_beside_the_export_shows_is_in_it(
    run: Path, signals: tuple[Signal[Any], ...]
) -> None:
    """Viewers show nothing, and say nothing, where a topic or a field of a layout is not there."""
    with RunReader(run) as reader:
        export(reader, "json-mcap", run.with_name("viewers.json.mcap"), signals)
    layout = json.loads(run.with_name("viewers.foxglove.json").read_text(encoding="utf-8"))
    panels, placed, unread = layout["configById"], set[str](), [layout["layout"]]
    while unread:
        match unread.pop():
            case {"direction": _, "first": first, "second": second}:
                unread += [first, second]
            case str(panel):
                placed.add(panel)
    assert placed == panels.keys()
    found = list(entries(run.with_name("viewers.json.mcap")))
    topics = {entry.channel.topic: entry.schema for entry in found}
    paths = [line["value"] for panel in panels.values() for line in panel.get("paths", ())]
    for topic, _, field in (path.rpartition(".") for path in paths):
        assert field in json.loads(topics[topic].data)["properties"]
    assert bool(paths) == (RESIDUAL not in signals)


@pytest.mark.parametrize("plant", ["oahu", "hope-melpitz"])
def test_viewers_can_read_the_paths_of_a_layout(plant: str) -> None:
    """A topic is of letters, digits, `_` and `/`, or stands in quotes."""
    plan = with_changes(PLAN, plant=plant)
    panels: Any = layout(plan, recorded_ports(plan))["configById"]
    paths = [line["value"] for panel in panels.values() for line in panel.get("paths", ())]
    topics = [path.rpartition(".")[0] for path in paths]
    topics += [panel["topicPath"] for panel in panels.values() if "topicPath" in panel]
    assert len(topics) > 4
    for topic in topics:
        assert re.fullmatch(r'[A-Za-z0-9_/]+|"[^"]+"', topic)
        assert topic.strip('"').startswith(f"{plant}/")
