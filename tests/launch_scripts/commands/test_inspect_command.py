"""`heliarch inspect`: what it prints of a whole recording, of one node, of one cycle."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from command_line import done, heliarch, refusal
from recordings_by_hand import cut, whole_run, write_run, zero_chunk

from recordings import open_run


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("inspect") / "run.mcap"
    write_run(
        path,
        whole_run(120),
        messages_per_chunk=300,
        is_kept=lambda pair: str(pair[0]) != "c1/a/impp" or not 20 <= pair[1].cycle < 25,
    )
    return path


def test_a_recording_is_told_with_what_is_missing_in_it(recording: Path) -> None:
    text = done("inspect", recording)
    facts = " ".join(text.split())
    assert "Scenario Four inverters" in facts
    assert "Time 2010-04-01 12:00:00 to 2010-04-01 12:01:59, Pacific/Honolulu" in facts
    assert "Cycles 0 to 119 of 1 s, 120 complete, 1,000 planned" in facts
    assert "host" not in facts.lower(), "a run in memory does not depend on it"
    (row,) = [line.split() for line in text.splitlines() if line.startswith("impp ")]
    assert row[1:3] == ["7", "835"]
    assert row[5:] == ["5", "0", "5"]
    assert "5 messages not recorded: c1/a/impp 5" in facts
    (gap,) = [line for line in text.splitlines() if line.startswith("c1/a/impp ")]
    numbers = re.findall(r"[\d:]{2,}|\b\d\b", gap.removeprefix("c1/a/impp "))
    assert numbers == ["5", "20", "24", "12:00:20", "12:00:24"]
    assert all(len(line) <= 80 for line in text.splitlines() if "run.mcap" not in line)


def test_the_timeline_of_a_node_has_a_line_for_each_cycle_of_the_span(recording: Path) -> None:
    text = done("inspect", recording, "--nodes", "c1/a", "--from", "12:00:18", "--to", "26")
    heading, units, *lines = text.splitlines()
    assert heading.split()[:4] == ["cycle", "time", "power", "IMPP"]
    assert units.split()[:4] == ["local", "kW", "kW", "kW"]
    assert lines[1::2] == [" " * 16 + "from b 20.00"] * 9
    assert [line.split()[0] for line in lines[::2]] == [str(cycle) for cycle in range(18, 27)]
    impp = [line.split()[3] for line in lines[::2]]
    assert impp == ["40.00"] * 2 + ["-"] * 5 + ["40.00"] * 2


def test_each_of_several_nodes_is_named_above_its_lines(recording: Path) -> None:
    text = done("inspect", recording, "--nodes", "c1/a,c1,central", "--from", "5", "--to", "6")
    names = ["c1/a", "c1", "central"]
    assert [line for line in text.splitlines() if line in names] == names


def test_figures_come_as_json_too(recording: Path, tmp_path: Path) -> None:
    overview: dict[str, Any] = json.loads(done("inspect", recording, "--json", "-"))
    assert overview["complete_cycles"] == 120
    assert overview["gaps"] == [
        {"port": "c1/a/impp", "first_cycle": 20, "last_cycle": 24, "cycles": 5}
    ]
    out = tmp_path / "nodes.json"
    done("inspect", recording, "--nodes", "c1/b", "--from", "3", "--to", "5", "--json", out)
    rows = json.loads(out.read_text())
    assert [(row["cycle"], row["help_for"]) for row in rows] == [
        (cycle, [{"node": "c1/a", "power_kw": 20.0}]) for cycle in (3, 4, 5)
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["nodes.json"]
    nodes = json.loads(done("inspect", recording, "--cycle", "3", "--json", "-"))
    named = " ".join(node["node"] for node in nodes)
    assert named == "central c1 c2 c1/a c1/b c2/c c2/d"
    part = done("inspect", recording, "--from", "30s", "--to", "39s")
    assert "30 to 39 of 1 s, 10 complete" in part


def test_a_recording_that_was_cut_is_shown_and_recover_is_named(
    recording: Path, tmp_path: Path
) -> None:
    short = tmp_path / "run.mcap"
    cut(recording, short)
    text = done("inspect", short)
    assert ["File", "cut"] in [line.split() for line in text.splitlines()]
    assert "`heliarch recover` makes a whole file of it" in " ".join(text.split())
    assert "recover" in done("inspect", short, "--nodes", "c1/a", "--to", "3")
    assert "--to: expected a time of the run" in refusal(
        "inspect", short, "--nodes", "c1/a", "--to", "12:01:59"
    )


@pytest.fixture
def damaged(recording: Path, tmp_path: Path) -> Path:
    """The recording with the head of a chunk in the middle zeroed."""
    path = tmp_path / "run.mcap"
    place = zero_chunk(recording, 4, path)
    with open_run(recording) as run:
        assert 40 in run.cycles_in(place)[1:-1]
    return path


@pytest.mark.parametrize(
    "words", [[], ["--nodes", "c1/a"], ["--nodes", "c1/a", "--from", "35", "--to", "45"]]
)
def test_a_damaged_part_is_told_in_one_line_at_the_end(damaged: Path, words: list[str]) -> None:
    result = heliarch("inspect", damaged, *words)
    assert result.exit_code == 0
    assert result.stdout
    assert result.stderr.count("\n") == 1
    assert "a part of the file is damaged (chunk at byte" in result.stderr
    assert "missing): see heliarch recover" in result.stderr
    assert "a part of the file is damaged" in refusal("inspect", damaged, "--cycle", "40")


def test_a_damaged_attachment_is_named_or_refused(recording: Path, tmp_path: Path) -> None:
    path, content = tmp_path / "run.mcap", recording.read_bytes()
    for text in (b"Four inverters", b'"inverters"'):
        torn = bytearray(content)
        torn[content.index(text) + 2] ^= 1
        path.write_bytes(torn)
        result = heliarch("inspect", path)
        plan = text != b"Four inverters"
        assert result.exit_code == (2 if plan else 0), result.output
        assert ("plan.json is damaged" if plan else "(attachment scenario.toml)") in result.stderr
        assert result.stderr.count("\n") == 1
