"""An inbox that more comes into than its agent looks at: bounded, and nobody is kept out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import zenoh

from bus_schemas.zenoh_bus import Inbox


@dataclass(frozen=True)
class Sample:
    """What an inbox looks at of a sample, when it is crowded."""

    key_expr: str


def put(inbox: Inbox, key: str, count: int = 1) -> None:
    for _ in range(count):
        inbox.put(cast("zenoh.Sample", Sample(key)))


def keys(inbox: Inbox) -> list[str]:
    return [str(sample.key_expr) for _, sample in inbox.take(1, timeout_s=0.0)]


def test_a_flood_of_one_key_is_bounded_and_counted() -> None:
    inbox = Inbox()
    put(inbox, "c1/inv07/impp", 200_000)
    waiting = len(keys(inbox))
    assert waiting < 11_000
    assert inbox.flooded == {"c1/inv07/impp": 200_000 - waiting}


def test_others_are_heard_through_a_flood() -> None:
    inbox = Inbox()
    put(inbox, "c1/inv07/impp", 50_000)
    put(inbox, "c1/inv01/impp")
    put(inbox, "c1/inv07/impp", 50_000)
    put(inbox, "c1/setpoint")
    heard = keys(inbox)
    assert {"c1/inv01/impp", "c1/setpoint"} <= set(heard)
    assert set(inbox.flooded) == {"c1/inv07/impp"}


def test_once_it_was_emptied_there_is_room_again() -> None:
    inbox = Inbox()
    put(inbox, "c1/inv07/impp", 50_000)
    keys(inbox)
    put(inbox, "c1/inv07/impp", 5)
    assert keys(inbox) == ["c1/inv07/impp"] * 5


def test_keys_without_end_fill_neither_inbox_nor_account() -> None:
    inbox = Inbox()
    for number in range(100_000):
        put(inbox, f"c1/nobody{number}/impp")
    assert len(keys(inbox)) <= 20_000
    assert len(inbox.flooded) <= 101
    assert inbox.flooded.total() == 80_000


def test_what_a_whole_plant_sends_at_once_finds_room() -> None:
    inbox = Inbox()
    for number in range(9_000):
        put(inbox, f"c1/inv{number}/command")
    assert len(keys(inbox)) == 9_000
    assert not inbox.flooded
