"""The document for foreign programs says what is on the wire."""

from __future__ import annotations

import re
from pathlib import Path

import msgpack
import msgspec
import pytest

from bus_schemas.codec import decode
from bus_schemas.signals import REQUEST, SIGNALS
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
    telemetry, impp, residual, setpoint, command, start = found
    assert (telemetry["source"], telemetry["power_kw"], telemetry["cycle"]) == ("plant", 120.5, 2)
    assert (impp["cycle"], impp["sequence"], impp["power_kw"]) == (-999_999, 0, 241.0)
    assert (residual["missing"], residual["power_kw"]) == (["c1/inv07/request"], -20.0)
    assert setpoint["help_given"] == [["c1/inv01", 20.0]]
    assert (command["source"], command["power_kw"], command["missing"]) == ("c1/inv07", 100.0, [])
    assert (start["state"], start["cycle_wall_ns"]) == ("start", 1_000_000_000)


def test_what_it_says_of_payloads_is_what_the_codec_does() -> None:
    head = {"cycle": 1, "sim_time_ns": 2, "source": "c1", "missing": []}
    whole = msgpack.packb(head | {"power_kw": 3.5})
    for accepted in (
        whole,
        msgpack.packb({"power_kw": 3.5} | head),
        msgpack.packb(head | {"power_kw": 3}),
        msgpack.packb(head | {"power_kw": 3.5}, use_single_float=True),
    ):
        assert decode(REQUEST, accepted).cycle == 1
    for refused in (
        whole + b"\x00",
        msgpack.packb(head),
        msgpack.packb(head | {"power_kw": 3.5, "more": 1}),
        msgpack.packb(head | {"power_kw": None}),
        msgpack.packb(head | {"power_kw": 3.5, "cycle": 1.0}),
        msgpack.packb(head | {"power_kw": 3.5, "source": b"c1"}),
    ):
        with pytest.raises(msgspec.DecodeError):
            decode(REQUEST, refused)


def test_each_stage_says_what_it_publishes() -> None:
    text = wire_document()
    assert "| estimate | request, telemetry |  | impp, residual, `help` if it is negative |" in text
    assert "| actuate | setpoint |  | command |" in text
    assert "| report | impp, residual | help | impp, residual, `help` if it is negative |" in text
