"""The documents say what the code says: derived tables, and the rules around them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import pytest

from agents.plan import RunPlan
from bus_schemas.signals import SIGNALS
from docs.derived import (
    DOCUMENTS,
    VECTOR,
    descriptions,
    filled,
    scenario_tables,
    vector,
    vectors,
)
from docs.shown import PAGES, read
from docs.shown import filled as filled_by_figures
from scenarios.fault_rules import parse_fault
from scenarios.scenario import load_scenario

HOUSE = Path(__file__).parents[2]
WIRE = (HOUSE / "docs" / "wire.md").read_text(encoding="utf-8")
VECTORS = json.loads((HOUSE / "docs" / "wire-vectors.json").read_text(encoding="utf-8"))
SCENARIOS = (HOUSE / "docs" / "scenarios.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", DOCUMENTS)
def test_derived_parts_are_what_the_code_writes(name: str) -> None:
    text = (HOUSE / name).read_text(encoding="utf-8")
    assert text == filled(text), "python docs/derived.py"


def test_the_example_messages_are_what_the_code_writes() -> None:
    text = (HOUSE / "docs" / "wire-vectors.json").read_text(encoding="utf-8")
    assert text == vectors(), "python docs/derived.py"
    assert read(VECTOR) == vector(), "python docs/derived.py"


# Scenarios ----------------------------------------------------------------------------------------


def test_every_table_of_a_scenario_is_in_the_document() -> None:
    marked = set(re.findall("<!-- table: scenario (.*) -->", SCENARIOS))
    assert marked == scenario_tables().keys() - {"timing"}, "[timing] has nothing but its budgets"


def test_every_field_but_a_table_has_a_description() -> None:
    tables = scenario_tables()
    for name, kinds in tables.items():
        for struct in kinds.values():
            for field in struct.fields:
                is_table = {f"{name}.{field.encode_name}", field.encode_name} & tables.keys()
                assert is_table or field.name in descriptions(struct.cls), (name, field.name)


def test_the_examples_are_scenarios_that_are_accepted(tmp_path: Path) -> None:
    examples = re.findall(r"```toml\n(.*?)```", SCENARIOS, re.DOTALL)
    whole = load_scenario("oahu").path.read_text(encoding="utf-8") + "\n" + "\n".join(examples)
    path = tmp_path / "own.toml"
    path.write_text(whole, encoding="utf-8")
    found = load_scenario(str(path)).scenario
    assert found.timing.budgets.decision_p99_ms == {"direct": 4}
    option = "source=c1/*,signal=impp,delay=50ms,jitter=10ms,loss=2%,at=60s..90s"
    assert found.faults == (parse_fault(option),)


# On the wire --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "vector"), VECTORS.items())
def test_the_bytes_of_an_example_are_its_message_to_any_msgpack_reader(
    name: str, vector: dict[str, Any]
) -> None:
    payload = bytes.fromhex(vector["bytes"])
    assert msgpack.unpackb(payload) == vector["message"]
    assert vector["key"].startswith("oahu/c2/inv07/")
    next(signal for signal in SIGNALS if signal.name == name).decode(payload)


def test_every_field_of_the_plan_is_in_the_document() -> None:
    opening = WIRE.partition("## Signals")[0]
    named = set(re.findall(r"`([a-z_]+)`", opening))
    assert {field.name for field in msgspec.structs.fields(RunPlan)} <= named


# Measured tables and figures ----------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_shows_measured_tables_and_figures_as_they_are(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    emptied = re.sub(r"(<!-- measured: .* -->\n)(?:\|.*\n)*(<!-- end -->)", r"\1\2", text)
    emptied = re.sub(r"-->[^\n<]*<!--/-->", "--><!--/-->", emptied)
    assert filled_by_figures(page, emptied) == text, "make results writes them"
    assert not re.search(r"^<!--\S.*<!--/-->", text, re.MULTILINE), "mkdocs drops such a line"
