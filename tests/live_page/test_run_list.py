"""The list of runs is true of runs that are slow, deleted or have hardly begun."""

from __future__ import annotations

import os
import time
from pathlib import Path

import command_line
import pytest
from plans_by_hand import with_changes
from recordings_by_hand import PLAN, whole_run, write_run

from bus_schemas.errors import InputError
from heliarch import open_run
from live_page.run_list import run_list


def test_a_run_of_long_cycles_is_still_going_on_between_two_of_them(tmp_path: Path) -> None:
    path = tmp_path / "slow" / "run.mcap"
    path.parent.mkdir()
    write_run(path, whole_run(2), plan=with_changes(PLAN, cycle_wall_ns=60_000_000_000))
    os.utime(path, (time.time() - 50.0,) * 2)
    assert [row["state"] for row in run_list(tmp_path)["runs"]] == ["running"]
    os.utime(path, (time.time() - 500.0,) * 2)
    assert [row["state"] for row in run_list(tmp_path)["runs"]] == ["unfinished"]
    path.with_name("run-2.mcap").touch()  # It goes on in a further file.
    assert [row["state"] for row in run_list(tmp_path)["runs"]] == ["running"]


def test_a_recording_without_a_head_is_looked_at_again_when_it_has_one(tmp_path: Path) -> None:
    path = tmp_path / "young" / "run.mcap"
    path.parent.mkdir()
    write_run(path, whole_run(2))
    whole = path.read_bytes()
    with path.open("r+b") as file:
        file.truncate(20)
    (young,) = run_list(tmp_path)["runs"]
    assert young["unreadable"]
    with path.open("r+b") as file:
        file.write(whole)
    (grown,) = run_list(tmp_path)["runs"]
    assert (grown["unreadable"], grown["inverters"]) == ("", 4)


def test_a_summary_of_another_version_is_named_wherever_it_is_read(tmp_path: Path) -> None:
    folder = tmp_path / "old"
    folder.mkdir()
    write_run(folder / "run.mcap", whole_run(2))
    (folder / "summary.json").write_text('{"run_id": "by-hand", "plant": "field"}')
    (row,) = run_list(tmp_path)["runs"]
    inspected = command_line.heliarch("inspect", folder)
    with open_run(folder) as run, pytest.raises(InputError) as refused:
        str(run.summary)
    for text in (row["state"], inspected.output, str(refused.value)):
        assert "of another version" in text.replace("\n", " ")


def test_a_run_that_is_deleted_while_it_is_listed_is_left_out(tmp_path: Path) -> None:
    for name in ("kept", "deleted"):
        (tmp_path / name).mkdir()
    write_run(tmp_path / "kept" / "run.mcap", whole_run(2))
    (tmp_path / "deleted" / "run.mcap").symlink_to(tmp_path / "nowhere")
    assert [row["name"] for row in run_list(tmp_path)["runs"]] == ["kept"]
