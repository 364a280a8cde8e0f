"""`heliarch init`: the scenario that it writes runs as it is, and says how good the data are."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command_line import done, refusal
from running import REPOSITORY


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with the two files of a plant in a folder of their own."""
    shutil.copytree(REPOSITORY / "examples" / "own_plant", tmp_path / "measured")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_it(scenario: str) -> tuple[list[str], str]:
    """Run a scenario; return what its summary remarks and its report say."""
    done("simulate", scenario, "--out", "run", "--report", "--json", "summary.json")
    summary = json.loads(Path("summary.json").read_text(encoding="utf-8"))
    assert summary["cycles"] == 61
    return summary["remarks"], Path("run/report.html").read_text(encoding="utf-8")


FILES = ("measured/positions.csv", "measured/ghi.csv")


def test_the_scenario_runs_at_once_and_replaces_no_file(folder: Path) -> None:
    printed = done("init", *FILES, "--out", "plant.toml")
    assert "heliarch simulate plant.toml" in printed
    (hindsight,) = run_it("plant.toml")[0]
    assert "hindsight" in hindsight
    assert "--out" in refusal("init", *FILES, "--out", "plant.toml")


def test_an_archive_of_one_station_makes_a_plant_and_says_how(folder: Path) -> None:
    rows = [f"{600 + at},2024-06-15T{18 + at // 12}:{5 * at % 60:02}:00Z,PT5M" for at in range(12)]
    text = "\n".join(["ghi,period_end,period", *rows, ""])
    (folder / "roof.csv").write_text(text, encoding="utf-8")
    printed = done("init", FILES[0], "solcast:roof.csv", "--cloud-speed", "5")
    told = "move over the plant, unchanged, at 5 m/s from 270 degrees"
    assert told in printed
    assert told in (folder / "my-plant.toml").read_text(encoding="utf-8").splitlines()[0]
    assert (folder / "my-plant-ghi.csv").exists()
    done("simulate", "my-plant.toml", "--out", "run")


@pytest.mark.parametrize(("name", "start"), [("p.html", b"<!"), ("p.png", b"\x89PNG")])
def test_a_preview_is_a_page_or_a_picture(folder: Path, name: str, start: bytes) -> None:
    assert f"preview: {name}" in done("init", *FILES, "--preview", name)
    assert (folder / name).read_bytes().startswith(start)
    assert "--preview" in refusal("init", *FILES, "--out", "b.toml", "--preview", "p.gif")
