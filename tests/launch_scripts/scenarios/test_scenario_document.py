"""The document about scenarios says what scenarios are checked with."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
import pytest
from launch_scripts.scenarios.accepted_words import accepted_fields
from launch_scripts.scenarios.scenario_document import scenario_document

from bus_schemas.faults import LONGEST_MS, FaultRule
from launch_scripts.scenarios.fault_rules import parse_fault
from launch_scripts.scenarios.machine_table import MachineTable
from launch_scripts.scenarios.scenario import Scenario, load_scenario, shipped_scenarios

DOCUMENT = Path(__file__).parents[2] / "docs" / "scenarios.md"
TEXT = scenario_document()


def rows_of(heading: str) -> dict[str, list[str]]:
    """Return the cells of each row of the table under a heading, by the field's name."""
    section = TEXT.partition(f"## {heading}\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \| (.*) \| (.*) \| (.*) \|$", section, re.MULTILINE)
    return {name: cells for name, *cells in rows}


def test_the_file_is_what_the_code_writes() -> None:
    assert DOCUMENT.read_text(encoding="utf-8") == TEXT, (
        "python -m launch_scripts.scenarios.scenario_document > docs/scenarios.md"
    )


@pytest.mark.parametrize("table", ["time", "plant", "control", "neighbours", "pv", "machine"])
def test_each_field_of_a_table_is_told_with_what_it_takes_and_is(table: str) -> None:
    rows = rows_of(f"`[{table}]`")
    assert tuple(rows) == accepted_fields(Scenario, table)
    assert all(takes and meaning for takes, _, meaning in rows.values())


def test_each_field_of_a_fault_is_told_by_its_name_in_a_file() -> None:
    rows = rows_of("`[[faults]]`")
    assert list(rows) == [field.encode_name for field in msgspec.structs.fields(FaultRule)]
    assert rows["delay_ms"][:2] == ["number", "0"]
    assert "uniform" in rows["distribution"][1]


def test_each_kind_of_a_table_is_told() -> None:
    for table in ("irradiance", "commitment", "regulation"):
        kinds = re.findall(rf'^### `\[{table}\]` with `kind = "([a-z-]+)"`$', TEXT, re.MULTILINE)
        assert len(kinds) > 1
        assert f"{', '.join(f'`{kind}`' for kind in kinds)}." in TEXT


def test_bounds_and_defaults_are_those_of_the_structs() -> None:
    assert rows_of("`[machine]`")["priority"][:2] == ["whole number from 0, up to 99", "0"]
    assert rows_of("`[machine]`")["lock_memory"][:2] == ["`true` or `false`", "`false`"]
    assert rows_of("`[time]`")["cycle_s"][:2] == ["number from 0.001, up to 3600", "1"]
    assert rows_of("`[time]`")["start"][:2] == ["date and time", "required"]
    assert rows_of("The file itself")["pace"][:2] == [
        'number from 0.001, up to 1000000 or `"max"`',
        '`"max"`',
    ]


def test_every_field_that_a_shipped_scenario_has_is_in_the_document() -> None:
    for name in shipped_scenarios():
        text = load_scenario(name).path.read_text(encoding="utf-8")
        for field in re.findall(r"^(\w+) = ", text, re.MULTILINE):
            assert f"`{field}`" in TEXT


def test_the_examples_are_scenarios_that_are_accepted(tmp_path: Path) -> None:
    examples = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)
    assert len(examples) == 3
    whole = load_scenario("oahu").path.read_text(encoding="utf-8") + "\n" + "\n".join(examples)
    path = tmp_path / "own.toml"
    path.write_text(whole, encoding="utf-8")
    found = load_scenario(str(path)).scenario
    assert found.machine == MachineTable(cpus=("0-1", "recorder=1"), priority=20, lock_memory=True)
    assert found.timing.stated.decision_p99_ms == {"direct": 4}
    option = "source=c1/*,signal=impp,delay=50ms,jitter=10ms,loss=2%,silent=60s..90s"
    assert found.faults == (parse_fault(option),)


def test_what_is_said_of_the_times_of_faults_is_their_bound() -> None:
    assert f"times 0 to {LONGEST_MS:,.0f} ms" in TEXT
