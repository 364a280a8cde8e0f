"""The document for foreign programs says what is on the wire."""

from __future__ import annotations

import re
from pathlib import Path

import msgpack

from bus_schemas.signals import SIGNALS
from launch_scripts.wire_document import wire_document

DOCUMENT = Path(__file__).parents[2] / "docs" / "wire.md"


def test_the_file_is_what_the_code_writes() -> None:
    assert DOCUMENT.read_text(encoding="utf-8") == wire_document(), (
        "python -m launch_scripts.wire_document > docs/wire.md"
    )


def test_every_signal_and_type_is_there() -> None:
    text = wire_document()
    for signal in SIGNALS:
        assert f"/{signal.name}` | {signal.type.__name__} |" in text
        assert f"### {signal.type.__name__}\n" in text


def test_the_examples_are_whole_messages_that_any_msgpack_reader_takes_apart() -> None:
    examples = wire_document().split("| bytes (hex) |")[1:]
    found = []
    for example in examples:
        rows = example.split("\n\n")[0]
        data = bytes.fromhex("".join(re.findall(r"^\| `([0-9a-f ]+)` \|", rows, re.MULTILINE)))
        found.append(msgpack.unpackb(data))
    telemetry, command = found
    assert (telemetry["source"], telemetry["power_kw"], telemetry["cycle"]) == ("plant", 120.5, 2)
    assert (command["source"], command["power_kw"], command["missing"]) == ("c1/inv07", 100.0, [])
