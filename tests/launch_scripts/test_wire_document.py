"""The document for foreign programs says what is on the wire."""

from __future__ import annotations

import re
from pathlib import Path

import msgpack
import msgspec
import pytest

from agents.plan import RunPlan
from bus_schemas.codec import decode
from bus_schemas.messages import LONGEST_MISSING, MOST_MISSING
from bus_schemas.signals import RESIDUAL, SIGNALS
from bus_schemas.tree import LONGEST_PATH
from launch_scripts import cli
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
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
    assert (residual["missing"], residual["power_kw"]) == (["dispatch@1"], -20.0)
    assert setpoint["help_given"] == [["c2/inv05", 20.0]]
    assert (command["source"], command["power_kw"], command["missing"]) == ("c2/inv07", 100.0, [])
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
        assert decode(RESIDUAL, accepted).cycle == 1
    for refused in (
        whole + b"\x00",
        msgpack.packb(head),
        msgpack.packb(head | {"power_kw": 3.5, "more": 1}),
        msgpack.packb(head | {"power_kw": None}),
        msgpack.packb(head | {"power_kw": 3.5, "cycle": 1.0}),
        msgpack.packb(head | {"power_kw": 3.5, "source": b"c1"}),
    ):
        with pytest.raises(msgspec.DecodeError):
            decode(RESIDUAL, refused)


def test_what_a_docstring_says_of_fields_stands_in_the_table_and_not_as_a_heading() -> None:
    text = wire_document()
    assert "Attributes" not in text
    assert not re.search(r"^-{3,}$", text, re.MULTILINE), "an underlined line renders as a heading"
    row = re.search(r"^\| `ready_time_ns` \| integer \| (.+) \|$", text, re.MULTILINE)
    assert row
    assert row[1].startswith("Monotonic clock of the sending host")


def test_the_bounds_of_texts_are_those_that_are_kept() -> None:
    text = wire_document()
    assert f"At most {LONGEST_PATH} characters." in text
    assert f"At most {MOST_MISSING:,} entries of up to {LONGEST_MISSING} characters." in text
    rules = text.partition("\n## Rules")[2]
    assert f"`source` and paths {LONGEST_PATH} characters" in rules
    assert f"`missing` {MOST_MISSING:,} entries of {LONGEST_MISSING}\n" in rules


def test_each_stage_says_what_it_publishes() -> None:
    text = wire_document()
    states = "impp, residual, `help` if it is negative"
    assert f"| estimate | dispatch, telemetry |  | {states} |" in text
    assert "| actuate | setpoint | dispatch | command |" in text
    assert f"| report | dispatch, impp, residual |  | {states} |" in text
    assert "| apply | command |  | production |" in text


def test_the_nodes_in_the_commands_of_the_documents_are_those_of_the_scenario() -> None:
    plan = prepare(load_scenario("oahu"), RunOptions(duration="10"), "run-1").plan
    known = {*plan.tree.agents(), *(node for node in plan.tree.nodes if node)}
    folder = DOCUMENT.parents[1]
    found = set()
    for path in (*folder.glob("*.md"), *folder.glob("docs/*.md"), *folder.glob("examples/*")):
        if path.suffix in {".md", ".py"}:
            text = path.read_text(encoding="utf-8")
            words = re.findall(r"--(?:external|node|nodes|live) ([a-z0-9/,]+)", text)
            found |= {(path.name, node) for word in words for node in word.split(",")}
    found |= {
        ("cli.py", node) for node in re.findall(r"c\d/inv\d+", Path(cli.__file__).read_text())
    }
    found |= {("wire.md", node) for node in re.findall(r"c\d/inv\d+", wire_document())}
    assert {name for name, _ in found} >= {"README.md", "wire.md", "direct_controller.py"}
    assert [(name, node) for name, node in sorted(found) if node not in known] == []


def test_every_field_of_the_plan_is_in_the_document() -> None:
    opening = wire_document().partition("## Signals")[0]
    named = set(re.findall(r"`([a-z_]+)`", opening))
    assert {field.name for field in msgspec.structs.fields(RunPlan)} <= named
