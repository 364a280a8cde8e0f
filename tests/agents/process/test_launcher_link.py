"""Events and requests arrive whole, and each from the one who said it."""

from __future__ import annotations

import pytest

from agents.process.launcher_link import Packets, packets

LONG = b"x" * 250_000


def test_a_text_of_many_packets_comes_whole_between_those_of_others() -> None:
    reader = Packets()
    *parts, last = packets("recorder", LONG)
    assert all(len(part) < 100_000 for part in parts)
    assert [reader.feed(part) for part in parts] == [None] * len(parts)
    assert [reader.feed(part) for part in packets("c1/inv07", b"y")] == [("c1/inv07", b"y")]
    assert reader.feed(last) == ("recorder", LONG)


@pytest.mark.parametrize("kept", [1, 2])
@pytest.mark.parametrize("after", [b"", b"ended", LONG])
def test_a_text_that_was_only_begun_does_not_spoil_the_next_one(kept: int, after: bytes) -> None:
    reader = Packets()
    for part in list(packets("recorder", LONG))[:kept]:
        reader.feed(part)
    assert [reader.feed(part) for part in packets("recorder", after)][-1] == ("recorder", after)


def test_the_end_of_a_text_without_its_beginning_is_no_text() -> None:
    assert Packets().feed(list(packets("recorder", LONG))[-1]) is None
