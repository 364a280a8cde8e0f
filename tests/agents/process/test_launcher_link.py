"""Events reach the launcher whole, and each from the one who said it."""

from __future__ import annotations

import msgspec

from agents.process.events import Complaint, Exited, Recorded
from agents.process.launcher_link import EventReader, packets, server_packet

LONG = Recorded({"impp": 1}, 0, 5, complaints=(Complaint("k", "out_of_range", 1, "x" * 200_000),))
EXITED = Exited(-9, 1.0)


def test_an_event_of_many_packets_comes_whole_between_those_of_others() -> None:
    reader = EventReader()
    *parts, last = packets("recorder", msgspec.json.encode(LONG))
    other = packets("c1/inv07", msgspec.json.encode(EXITED))
    assert [reader.feed(part) for part in parts] == [None] * len(parts)
    assert [reader.feed(part) for part in other] == [("c1/inv07", EXITED)]
    assert reader.feed(last) == ("recorder", LONG)


def test_what_an_agent_only_began_to_say_does_not_spoil_the_news_of_its_end() -> None:
    reader = EventReader()
    reader.feed(packets("recorder", msgspec.json.encode(LONG))[0])
    packet = server_packet("recorder", msgspec.json.encode(EXITED))
    assert reader.feed(packet) == ("recorder", EXITED)
