"""A recording in several files, since each was full after some cycles or at some size."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from command_line import python
from recorded_runs import cloudy_profile, plan_of, published, record
from recordings_by_hand import write_messages

from agents.plan import changed
from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.signals import PRODUCTION
from bus_schemas.tree import RECORDER
from live_page.follower import RunFollower
from recordings.inspect.overview import read_through
from recordings.read.gaps import unrecorded_spans
from recordings.read.reader import RunReader
from recordings.read.run_file import next_path
from recordings.record.writer import RunWriter
from recordings.verify.verification import verify
from scenarios.run_options import ProcessOptions
from sim_plant.profile import PROFILE_NAME

CYCLES = 40
WHOLE = plan_of(cycles=CYCLES)
PLAN = changed(WHOLE, supervision={"file_cycles": 10})
PROFILE = cloudy_profile(WHOLE)
SAID = published(WHOLE, PROFILE)


def written(folder: Path, said: list[Delivery] = SAID) -> Path:
    """Write a run, flushed after every cycle or so. Return its first file."""
    path = folder / "run.mcap"
    each_cycle = len(SAID) // CYCLES
    write_messages(path, said, plan=PLAN, scenario='name = "oahu"\n', messages_per_chunk=each_cycle)
    return path


def test_all_files_of_a_recording_are_one_run(tmp_path: Path) -> None:
    written(tmp_path)
    PROFILE.save(tmp_path / PROFILE_NAME)
    record(tmp_path / "whole", WHOLE, SAID, PROFILE)
    with RunReader(tmp_path) as split, RunReader(tmp_path / "whole") as whole:
        assert len(split.files) > 3
        assert [*split.messages()] == [*whole.messages()]
        found, _ = read_through(split)
        expected, _ = read_through(whole)
    assert (found.whole, found.complete_cycles, found.lost, found.states) == (True, CYCLES, {}, ())
    assert found.signals == expected.signals
    checked = verify(tmp_path)
    assert checked.equal
    assert checked.total("compared") == verify(tmp_path / "whole").total("compared")


def test_a_file_that_was_deleted_is_a_gap_and_no_number_comes_again(tmp_path: Path) -> None:
    path = written(tmp_path)
    following = next_path(path)
    with RunReader(tmp_path / "run-3.mcap") as part:
        gone = [message.cycle for _, message in part.messages(PRODUCTION)]
    part.path.unlink()
    assert next_path(path) == following
    with RunReader(tmp_path) as run:
        found, _ = read_through(run)
        assert not run.whole
        assert run.damage_text().endswith("(run-3.mcap)")
    (gap,) = (one for one in found.states if one.agent == RECORDER)
    assert (
        {*gone[1:-1]} <= {*range(gap.first_cycle, gap.end)} <= {*range(gone[0] - 1, gone[-1] + 2)}
    )
    assert found.complete_cycles == CYCLES - len(gone)
    assert not verify(tmp_path).differs


def test_a_run_of_more_files_than_a_process_may_open_is_read(tmp_path: Path) -> None:
    each_cycle = changed(PLAN, supervision={"file_cycles": 1})
    step = len(SAID) // CYCLES
    write_messages(tmp_path / "run.mcap", SAID, plan=each_cycle, messages_per_chunk=step)
    found = python(
        """
import sys
from pathlib import Path
from resource import RLIMIT_NOFILE, setrlimit
from recordings.read.reader import RunReader
setrlimit(RLIMIT_NOFILE, (30, 30))
with RunReader(Path(sys.argv[1])) as run:
    print(len(run.files), sum(1 for _ in run.messages()))
""",
        tmp_path / "run.mcap",
    )
    files, messages = map(int, found.stdout.split())
    assert files > 30
    assert messages == sum(port.signal.logged for port, _ in SAID)


def test_files_that_are_deleted_while_they_are_read_are_named_once(tmp_path: Path) -> None:
    written(tmp_path)
    with RunReader(tmp_path) as run:
        for path in run.files[1:3]:
            path.unlink()
        cycles = {message.cycle for _, message in run.messages(PRODUCTION)}
        assert run.damage_text().endswith(" of this run (run-2.mcap, run-3.mcap)")
    assert {0, CYCLES - 1} <= cycles < {*range(CYCLES)}


def test_a_recorder_that_is_started_again_fills_its_first_file(tmp_path: Path) -> None:
    said = [(port, message) for port, message in SAID if 20 <= message.cycle < 40]
    step = len(SAID) // CYCLES
    path = tmp_path / "run-2.mcap"
    write_messages(path, said, plan=PLAN, messages_per_chunk=step)
    with RunReader(path) as first:
        assert first.last_cycle >= 29


def test_a_file_that_has_just_begun_is_no_gap(tmp_path: Path) -> None:
    newest = next_path(written(tmp_path)).with_name("run-4.mcap")
    for later in tmp_path.glob("run-[5-9].mcap"):
        later.unlink()
    content = newest.read_bytes()
    newest.write_bytes(content[:2000])  # Its plan is not there yet.
    with RunReader(tmp_path) as run:
        assert len(run.files) == 3
        newest.write_bytes(content)
        run.join()
        assert len(run.files) == 4
        assert [*unrecorded_spans(run)] == []


@pytest.mark.parametrize("name", ["run-02.mcap", "run-1.mcap", "run-x.mcap", "run-٢.mcap"])
def test_a_file_of_another_name_is_no_part_of_the_run(tmp_path: Path, name: str) -> None:
    path = written(tmp_path)
    following = next_path(path)
    shutil.copy(path, tmp_path / name)
    assert next_path(path) == following
    with RunReader(path) as run:
        assert len([*run.messages(PRODUCTION)]) == CYCLES


def test_a_run_is_followed_from_file_to_file(tmp_path: Path) -> None:
    half = len(SAID) // 2
    path = tmp_path / "run.mcap"
    each_cycle = len(SAID) // CYCLES
    write_messages(path, SAID[:half], plan=PLAN, messages_per_chunk=each_cycle, close=False)
    follower = RunFollower(path)
    while not follower.advance(1.0):
        pass
    assert len(follower.run.files) == 2
    assert follower.state == "running"
    assert follower.cycles in {CYCLES // 2 - 1, CYCLES // 2}


def test_a_file_is_full_at_a_size(tmp_path: Path) -> None:
    plan = changed(WHOLE, supervision={"file_bytes": 60_000})
    each_cycle = len(SAID) // CYCLES
    write_messages(tmp_path / "run.mcap", SAID, plan=plan, messages_per_chunk=each_cycle)
    sizes = [path.stat().st_size for path in tmp_path.glob("*.mcap")]
    assert len(sizes) > 1
    with RunReader(tmp_path) as run:
        assert len([*run.messages()]) == sum(port.signal.logged for port, _ in SAID)


@pytest.mark.parametrize("text", ["", "0", "0GB", "1.5.GB", "GB", "-1h", "1TB", "c0x"])
def test_what_is_neither_a_time_nor_a_size_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--split"):
        ProcessOptions(split=text)


def test_a_file_holds_messages_however_small_it_is_to_be(tmp_path: Path) -> None:
    plan = changed(WHOLE, supervision={"file_bytes": 1})
    writer = RunWriter(tmp_path / "run.mcap", plan, "", "launch")
    for _ in range(5):
        writer.flush()
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]
    writer.close()


def test_a_next_file_that_cannot_be_begun_counts_no_message_twice(tmp_path: Path) -> None:
    folder, port = tmp_path / "run", SAID[0][0]
    folder.mkdir()
    writer = RunWriter(folder / "run.mcap", PLAN, "", "launch", on_end=lambda _: None)
    writer.add(port, SAID[0][1], encode(SAID[0][1]), 0)
    last = next(message for one, message in reversed(SAID) if one is port)
    shutil.rmtree(folder)
    writer.add(port, last, encode(last), 0)
    writer.flush()
    assert writer.ended_early
    assert (writer.number_recorded, writer.recorded.total()) == (2, 2)
