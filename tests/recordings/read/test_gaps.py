"""Numbers tell which messages are lost, which came again, and whether their sender restarted."""

from __future__ import annotations

import pytest

from recordings.read.gaps import PortGaps


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
def test_gaps(seen: list[tuple[int, int]], lost: int, repeated: int) -> None:
    gaps = PortGaps()
    for cycle, sequence in seen:
        gaps.see(cycle, sequence)
    assert (gaps.lost, gaps.repeated) == (lost, repeated)
