"""`heliarch export` leaves a whole export or none, and says what it came to."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest
from command_line import done, heliarch
from recordings_by_hand import whole_run, write_run

from recordings.read.reader import RunReader
from recordings.read.run_file import RECORDING_NAME

CYCLES = 30
FORMS = ("json-mcap", "parquet", "csv")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of 30 cycles."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    done("simulate", "oahu", "--duration", f"{CYCLES}s", "--out", folder)
    return folder


@pytest.fixture
def run(recorded: Path, tmp_path: Path) -> Path:
    """A run of its own for a test."""
    return Path(shutil.copytree(recorded, tmp_path / "run"))


def cut(run: Path) -> None:
    """Cut a recording in the middle of its messages."""
    recording = run / RECORDING_NAME
    whole = recording.read_bytes()
    recording.write_bytes(whole[: len(whole) * 2 // 3])


# What comes out of it -----------------------------------------------------------------------------


def test_each_form_has_its_place_beside_the_recording(run: Path) -> None:
    for form, name in zip(FORMS, ("run.json.mcap", "run-parquet", "run-csv"), strict=True):
        assert done("export", run, "--format", form).endswith(f"{form}: {run / name}\n")
        assert (run / name).exists()


def test_a_part_of_the_run_may_be_exported(run: Path) -> None:
    part = ("--nodes", "c1/inv01,central", "--from", "12:00:10", "--to", "20")
    said = done("export", run, "--format", "csv", "--signals", "impp,setpoint", *part)
    assert "cycles 10 to 20" in said
    folder = run / "run-csv"
    assert {path.stem for path in folder.iterdir()} == {
        "impp",
        "setpoint",
        "help_given",
        "missing_inputs",
    }
    impp = pd.read_csv(folder / "impp.csv")
    assert set(impp["node"]) == {"c1/inv01", "central"}
    assert sorted(set(impp["cycle"])) == list(range(10, 21))
    assert len(impp) == 2 * 11


def test_the_figures_are_had_as_json(run: Path) -> None:
    figures = json.loads(
        done("export", run, "--format", "csv", "--json", "-", "--signals", "help,run")
    )
    folder = run / "run-csv"
    assert figures["path"] == str(folder)
    assert figures["whole"] is True
    assert (figures["first_cycle"], figures["last_cycle"]) == (0, CYCLES - 1)
    assert figures["size_bytes"] == sum(path.stat().st_size for path in folder.iterdir())
    rows = {part["name"]: part["rows"] for part in figures["parts"]}
    assert rows["run"] == 2
    assert rows["help"] == figures["messages"] - 2 > 0


@pytest.mark.parametrize("form", FORMS)
def test_of_a_cut_recording_everything_up_to_the_cut_is_exported(run: Path, form: str) -> None:
    cut(run)
    with RunReader(run) as reader:
        left = sum(1 for _ in reader.records())
        assert not reader.whole
    assert left
    said = done("export", run, "--format", form, "--json", run / "figures.json")
    assert "the recording was cut short" in said
    figures = json.loads((run / "figures.json").read_text())
    assert (figures["messages"], figures["whole"]) == (left, False)


@pytest.mark.parametrize("form", FORMS)
def test_a_damaged_part_is_left_out_and_told_in_one_line(tmp_path: Path, form: str) -> None:
    recording = tmp_path / RECORDING_NAME
    whole = len(write_run(recording, whole_run(CYCLES)))
    with RunReader(recording) as reader:
        place = reader.outline.chunks[2]
    content = bytearray(recording.read_bytes())
    content[place.offset : place.offset + 60] = bytes(60)
    recording.write_bytes(content)
    result = heliarch("export", recording, "--format", form, "--json", tmp_path / "figures.json")
    assert result.exit_code == 0, result.output
    (line,) = result.stderr.splitlines()
    assert f"a part of the file is damaged (chunk at byte {place.offset:,}, cycles " in line
    assert line.endswith("missing): see heliarch recover")
    assert json.loads((tmp_path / "figures.json").read_text())["messages"] == whole - 200


@pytest.mark.parametrize("form", FORMS)
def test_an_export_does_not_replace_what_is_there(run: Path, form: str, tmp_path: Path) -> None:
    path = tmp_path / "there"
    path.write_text("before")
    assert heliarch("export", run, "--format", form, "--out", path).exit_code == 2
    assert path.read_text() == "before"


def test_an_export_is_not_exported_again(run: Path) -> None:
    done("export", run, "--format", "json-mcap")
    assert heliarch("export", run / "run.json.mcap", "--format", "csv").exit_code == 2
