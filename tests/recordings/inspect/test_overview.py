"""What is missing of a recording is counted and named, and nothing else is."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import done
from recordings_by_hand import whole_run, write_run

from bus_schemas.bus import Delivery
from bus_schemas.errors import InputWarning
from recordings.inspect.overview import (
    Overview,
    read_overview,
)
from recordings.read.gaps import PortGaps
from recordings.read.reader import RunReader
from results.run_document import overview_of

CYCLES = 60
END = CYCLES - 1

Look = Callable[..., Overview]


@pytest.fixture
def look(tmp_path: Path) -> Look:
    """Write a recording and look at it."""

    def write_and_look(
        is_published: Callable[[Delivery], bool] = lambda delivery: True,
        is_kept: Callable[[Delivery], bool] = lambda delivery: True,
    ) -> Overview:
        path = tmp_path / "run.mcap"
        write_run(path, filter(is_published, whole_run(CYCLES)), is_kept=is_kept)
        with RunReader(path) as run:
            return read_overview(run)

    return write_and_look


def test_every_message_is_counted_and_nothing_is_missing(look: Look) -> None:
    overview = look()
    expected = Counter(port.signal.name for port, _ in whole_run(CYCLES))
    counted = {count.signal: count.messages for count in overview.signals if count.messages}
    assert counted == dict(expected)
    assert [count for count in overview.signals if count.lost or count.missing_cycles] == []
    assert (overview.last_cycle, overview.complete_cycles) == (END, CYCLES)
    assert overview.whole


def test_a_silent_agent_leaves_a_gap_in_cycles_and_none_in_numbers(look: Look) -> None:
    overview = look(
        is_published=lambda pair: not (pair[1].source == "c2/c" and 20 <= pair[1].cycle < 30)
    )
    missing = {
        count.signal: count.missing_cycles for count in overview.signals if count.missing_cycles
    }
    assert missing == {"impp": 10, "residual": 10, "command": 10}
    assert sum(count.lost for count in overview.signals) == 0


@pytest.mark.parametrize(
    ("seen", "lost", "repeated"),
    [
        ([(0, 0), (1, 1), (2, 2)], 0, 0),
        ([(2, 2), (3, 3), (6, 6)], 4, 0),
        ([(0, 0), (0, 1), (0, 2), (1, 4)], 1, 0),
        ([(0, 0), (1, 1), (1, 1), (2, 2), (2, 0), (3, 3)], 0, 2),
        ([(0, 0), (1, 1), (2, 2), (3, 3), (9, 0), (10, 1), (11, 3)], 1, 0),
        ([(0, 0), (1, 1), (9, 2), (10, 4)], 1, 0),
    ],
    ids=["all", "lost", "several a cycle", "copies", "restarted", "silent and back"],
)
def test_numbers_tell_what_is_lost_and_what_came_again(
    seen: list[tuple[int, int]], lost: int, repeated: int
) -> None:
    gaps = PortGaps()
    for cycle, sequence in seen:
        gaps.see(cycle, sequence)
    assert (gaps.lost, gaps.repeated) == (lost, repeated)


def test_the_overview_of_the_end_of_a_run_is_read_as_long_as_its_file_is_the_same(
    plant: str, tmp_path: Path
) -> None:
    done("simulate", plant, "--duration", "60", "--out", tmp_path / "run")
    path = tmp_path / "run" / "run.mcap"
    with RunReader(path) as run:
        kept = overview_of(run)
        assert kept == read_overview(run)

    times = path.stat().st_atime_ns, path.stat().st_mtime_ns
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    with pytest.warns(InputWarning), RunReader(path) as run:
        assert overview_of(run) != kept, "another file is read"
    os.utime(path, ns=times)
    with RunReader(path) as run:
        assert overview_of(run) == kept, "the same one is not"
