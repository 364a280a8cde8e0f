"""However long a recording gets, what its recorder and its next recorder need stays the same."""

from __future__ import annotations

from io import DEFAULT_BUFFER_SIZE
from pathlib import Path

import pytest
from memory_use import traced_memory
from recordings_by_hand import PLAN, SCENARIO, whole_run, write_messages

from bus_schemas.codec import encode
from recordings.inspect.overview import read_overview
from recordings.read.reader import RunReader
from recordings.record.recorder import next_file
from recordings.record.writer import ClockAnchor, RunWriter

CHUNKS = 100_000


def bytes_read() -> int:
    """What this process has read in all."""
    return int(Path("/proc/self/io").read_text(encoding="ascii").split()[1])


@pytest.fixture(scope="module")
def long_cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 100,000 chunks, cut in the last one."""
    path = tmp_path_factory.mktemp("long") / "run.mcap"
    anchor = ClockAnchor(5, 1_700_000_000_000_000_000)
    write_messages(path, whole_run(1), anchor=anchor, messages_per_chunk=10, close=False)
    with RunReader(path) as run:
        begin = run.outline.chunks[-1].offset
    content = path.read_bytes()
    path.write_bytes(content[:begin] + content[begin:] * CHUNKS + content[begin:-3])
    return path


def test_the_next_recorder_reads_the_beginning_of_a_long_recording_alone(long_cut: Path) -> None:
    before = bytes_read()
    path, anchor = next_file(long_cut)
    few = max(100_000, 3 * DEFAULT_BUFFER_SIZE)  # Of Python 3.14 a buffer alone has more.
    assert bytes_read() - before < few < long_cut.stat().st_size / 20
    assert path == long_cut.with_name("run-2.mcap")
    assert anchor == ClockAnchor(5, 1_700_000_000_000_000_000)


def test_the_memory_of_a_recorder_does_not_grow_with_its_messages(tmp_path: Path) -> None:
    writer = RunWriter(tmp_path / "run.mcap", PLAN, SCENARIO, "launch")
    said = [(port, message, encode(message)) for port, message in whole_run(2)]

    def write(chunks: int) -> int:
        for number in range(chunks):
            writer.add(*said[number % len(said)], number)
            writer.flush()
        return memory()[0]

    with traced_memory() as memory:
        write(100)
        grown = -write(100) + write(5_000)
    writer.close()
    assert grown < 20_000, "4 bytes a chunk"


@pytest.mark.parametrize("killed_at", ["once", "its first message"])
def test_recorders_that_were_killed_before_a_message_leave_a_recording_that_says_so(
    tmp_path: Path, killed_at: str
) -> None:
    first = tmp_path / "run.mcap"
    if killed_at == "once":
        first.touch()
        assert next_file(first) == (first, None)
    for _ in range(6):
        path, anchor = next_file(first)
        RunWriter(path, PLAN, SCENARIO, "launch", anchor).abandon()
    path, anchor = next_file(first)
    write_messages(path, whole_run(3), anchor=anchor)
    with RunReader(first) as run:
        assert read_overview(run).complete_cycles == 3
