"""`heliarch export` leaves a whole export or none, and says what it came to."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest
from command_line import done, heliarch, refusal
from recordings_by_hand import cut, whole_run, write_run, zero_chunk

from recordings.read.reader import RunReader
from recordings.read.run_file import RECORDING_NAME

CYCLES = 30
FORMS = ("json-mcap", "parquet", "csv")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Folder of a run of 30 cycles."""
    folder = tmp_path / "run"
    folder.mkdir()
    write_run(folder / RECORDING_NAME, whole_run(CYCLES))
    return folder


def test_each_form_has_its_place_beside_the_recording_and_replaces_nothing(run: Path) -> None:
    for form, name in zip(FORMS, ("run.json.mcap", "run-parquet", "run-csv"), strict=True):
        assert done("export", run, "--format", form).endswith(f"{form}: {run / name}\n")
        assert (run / name).exists()
        assert "exists already" in refusal("export", run, "--format", form)
    refusal("export", run / "run.json.mcap", "--format", "csv")  # It is no recording.


def test_a_part_of_the_run_may_be_exported_with_its_figures_as_json(run: Path) -> None:
    part = ("--nodes", "c1/a,central", "--from", "12:00:10", "--to", "20")
    words = ("--format", "csv", "--signals", "impp,setpoint", "--json", "-")
    figures = json.loads(done("export", run, *words, *part))
    folder = run / "run-csv"
    names = {"impp", "setpoint", "help_given", "missing_inputs"}
    assert {path.stem for path in folder.iterdir()} == names
    impp = pd.read_csv(folder / "impp.csv")
    assert set(impp["node"]) == {"c1/a", "central"}
    assert sorted(impp["cycle"]) == sorted([*range(10, 21)] * 2)
    assert (figures["path"], figures["whole"]) == (str(folder), True)
    assert (figures["first_cycle"], figures["last_cycle"]) == (10, 20)
    assert figures["size_bytes"] == sum(path.stat().st_size for path in folder.iterdir())
    assert {part["name"]: part["rows"] for part in figures["parts"]}["impp"] == len(impp)


@pytest.mark.parametrize("form", FORMS)
def test_of_a_cut_recording_everything_up_to_the_cut_is_exported(run: Path, form: str) -> None:
    cut(run / RECORDING_NAME, share=0.6)
    with RunReader(run) as reader:
        left = sum(1 for _ in reader.records())
        assert not reader.whole
    assert left
    said = done("export", run, "--format", form, "--json", run / "figures.json")
    assert "the recording was cut short" in said
    figures = json.loads((run / "figures.json").read_text())
    assert (figures["messages"], figures["whole"]) == (left, False)


@pytest.mark.parametrize("form", FORMS)
def test_a_damaged_part_is_left_out_and_told_in_one_line(run: Path, form: str) -> None:
    recording, figures = run / RECORDING_NAME, run / "figures.json"
    with RunReader(run) as reader:
        whole = sum(1 for _ in reader.records())
    place = zero_chunk(recording, 2)
    result = heliarch("export", recording, "--format", form, "--json", figures)
    assert result.exit_code == 0, result.output
    (line,) = result.stderr.splitlines()
    assert f"a part of the file is damaged (chunk at byte {place.offset:,}, cycles " in line
    assert line.endswith("missing): see heliarch recover")
    assert json.loads(figures.read_text())["messages"] == whole - 200
