"""The instructions beside the examples can be followed from the first line to the last."""

from __future__ import annotations

import re
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "examples"
TEXT = (EXAMPLES / "README.md").read_text(encoding="utf-8")


def test_no_two_runs_write_into_one_folder() -> None:
    folders = re.findall(r"--out (\S+)", TEXT)
    assert len(folders) >= 2
    assert len(folders) == len(set(folders)), "a folder that holds a run is refused"


def test_each_program_reads_the_plan_of_the_run_above_it() -> None:
    pairs = re.findall(r"--out (\S+)\n +python examples/(\S+) --plan (\S+)/plan\.json", TEXT)
    assert {program for _, program, _ in pairs} == {path.name for path in EXAMPLES.glob("*.py")}
    assert all(folder == read_from for folder, _, read_from in pairs)


def test_what_is_verified_has_been_run() -> None:
    verified = set(re.findall(r"heliarch verify (\S+?)`", TEXT))
    assert verified
    assert verified <= set(re.findall(r"--out (\S+)", TEXT))
