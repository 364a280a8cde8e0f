"""`heliarch inspect`, `export` and `report` on one recording, which lacks some messages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from command_line import done, heliarch, refusal
from recordings_by_hand import PLAN, whole_run, write_messages, write_run

from agents.plan import changed

CYCLES = 90


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Folder of a run that lacks what `c1/a` reports in five cycles."""
    folder = tmp_path / "run"
    folder.mkdir()
    write_run(
        folder / "run.mcap",
        whole_run(CYCLES),
        is_kept=lambda pair: str(pair[0]) != "c1/a/impp" or not 20 <= pair[1].cycle < 25,
    )
    return folder


def test_inspect_shows_what_a_recording_holds_and_what_is_missing(run: Path) -> None:
    text = done("inspect", run)
    facts = " ".join(text.split())
    assert "plant field, scheme paper" in facts
    assert "Time 2010-04-01 12:00:00 to 2010-04-01 12:01:29, Pacific/Honolulu" in facts
    assert "Cycles 0 to 89 of 1 s, 90 complete, 1,000 planned" in facts
    (row,) = [line.split() for line in text.splitlines() if line.startswith("impp ")]
    assert (row[1:3], row[5:]) == (["7", "625"], ["5", "0", "5"])


def test_figures_come_as_json_too(run: Path) -> None:
    overview: dict[str, Any] = json.loads(done("inspect", run, "--json", "-"))
    assert overview["complete_cycles"] == CYCLES
    words = ("--nodes", "c1/b,central", "--from", "12:00:03", "--to", "6")
    lines = done("inspect", run, *words).splitlines()
    assert [line for line in lines if line in {"c1/b", "central"}] == ["c1/b", "central"]
    rows = json.loads(done("inspect", run, *words, "--json", "-"))
    help_for = [{"node": "c1/a", "power_kw": 20.0}]
    assert [(row["node"], row["cycle"], row.get("help_for", [])) for row in rows] == [
        *(("c1/b", cycle, help_for) for cycle in (3, 4, 5)),
        *(("central", cycle, []) for cycle in (3, 4, 5)),
    ]
    plant = json.loads(done("inspect", run, "--cycle", "3", "--json", "-"))
    named = " ".join(node["node"] for node in plant["nodes"])
    assert named == "central c1 c2 c1/a c1/b c2/c c2/d"


@pytest.mark.parametrize(
    "words",
    [
        *(["inspect"], ["verify"], ["report", "--report", "page.html"], ["replay"]),
        ["inspect", "--nodes", "c1/a", "--from", "c5", "--to", "c80"],
        ["export", "--format", "csv", "--out", "tables"],
        ["export", "--format", "mcap", "--out", "whole.mcap"],
    ],
)
def test_every_command_names_the_files_of_a_run_that_were_deleted(
    tmp_path: Path, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    split = changed(PLAN, supervision={"file_cycles": 20})
    write_messages(tmp_path / "run.mcap", whole_run(CYCLES), plan=split, messages_per_chunk=30)
    for number in (2, 3):
        (tmp_path / f"run-{number}.mcap").unlink()
    result = heliarch(words[0], tmp_path, *words[1:])
    (line,) = result.stderr.splitlines()
    assert line.endswith("(run-2.mcap to run-3.mcap)"), result.output


@pytest.mark.parametrize(
    ("text", "status", "named"),
    [(b"Four inverters", 0, "attachment scenario.toml"), (b'"inverters"', 2, "plan.json")],
)
def test_a_damaged_attachment_is_named_or_refused(
    run: Path, text: bytes, status: int, named: str
) -> None:
    torn = bytearray((run / "run.mcap").read_bytes())
    torn[torn.index(text) + 2] ^= 1
    (run / "run.mcap").write_bytes(torn)
    result = heliarch("inspect", run)
    assert result.exit_code == status, result.output
    (line,) = result.stderr.splitlines()
    assert named in line


@pytest.mark.parametrize(
    ("form", "name"),
    [
        *(("json-mcap", "run.json.mcap"), ("mcap", "run.recovered.mcap")),
        *(("parquet", "run-parquet"), ("csv", "run-csv")),
    ],
)
def test_each_form_has_its_place_beside_the_recording_and_replaces_nothing(
    form: str, name: str, run: Path
) -> None:
    assert f"{form}: {run / name}\n" in done("export", run, "--format", form)
    assert "exists already" in refusal("export", run, "--format", form)


def test_a_part_of_the_run_may_be_exported_with_its_figures_as_json(run: Path) -> None:
    part = ("--nodes", "c1/a,central", "--from", "12:00:30", "--to", "41")
    words = ("--format", "csv", "--signals", "impp,setpoint", "--json", "-")
    figures = json.loads(done("export", run, *words, *part))
    folder = run / "run-csv"
    names = {"impp", "setpoint", "help_given", "missing_inputs"}
    assert {path.stem for path in folder.iterdir()} == names
    impp = pd.read_csv(folder / "impp.csv")
    assert set(impp["node"]) == {"c1/a", "central"}
    assert sorted(impp["cycle"]) == sorted([*range(30, 41)] * 2)
    assert (figures["path"], figures["whole"]) == (str(folder), True)
    assert (figures["first_cycle"], figures["last_cycle"]) == (30, 40)
    assert figures["rows"]["impp"] == len(impp)


@pytest.mark.parametrize(
    ("scenario", "named"), [('title = "Four"', "complete cycle"), ("name = oahu", "TOML")]
)
def test_a_run_without_a_complete_cycle_or_a_scenario_is_refused(
    scenario: str, named: str, tmp_path: Path
) -> None:
    write_messages(tmp_path / "run.mcap", [], scenario=scenario)
    assert named in refusal("report", tmp_path)
    assert not (tmp_path / "report.html").exists()
