"""A recording is walked through cycle by cycle, each once it is complete."""

from __future__ import annotations

from collections.abc import Iterator

from recorded_runs import cloudy_profile, plan_of, published

from bus_schemas.bus import Delivery
from bus_schemas.messages import Impp
from bus_schemas.signals import IMPP, RUN
from recordings.verify.recorded_cycles import CycleWalk

PLAN = plan_of(cycles=40)
PUBLISHED = published(PLAN, cloudy_profile(PLAN))


class Reading:
    """Deliveries that are read one by one, with a count of those that were."""

    def __init__(self, messages: list[Delivery]) -> None:
        self.count = 0
        self._messages = messages

    def __iter__(self) -> Iterator[Delivery]:
        for delivery in self._messages:
            self.count += 1
            yield delivery


def messages_in(walk: CycleWalk) -> int:
    return sum(len(cycle.messages) + len(cycle.repeated) for cycle in walk)


def test_each_cycle_comes_whole_and_in_its_order() -> None:
    walk = CycleWalk(PUBLISHED, PLAN.tree, PLAN.cycles)
    for number, cycle in enumerate(walk):
        assert cycle.number == number
        expected = {
            port: message
            for port, message in PUBLISHED
            if message.cycle == number and port.signal is not RUN
        }
        assert cycle.messages == expected
        assert cycle.repeated == []
    assert walk.read == len(PUBLISHED)
    assert walk.ended


def test_a_cycle_comes_as_soon_as_everybody_has_left_it_behind() -> None:
    reading = Reading(PUBLISHED)
    in_a_cycle = len(PUBLISHED) / PLAN.cycles
    for cycle in CycleWalk(reading, PLAN.tree, PLAN.cycles):
        assert reading.count <= (cycle.number + 4) * in_a_cycle + 20


def test_a_cycle_waits_for_an_agent_that_is_heard_late() -> None:
    late = [pair for pair in PUBLISHED if pair[0].publisher == "c2/c" and pair[1].cycle >= 3]
    others = [pair for pair in PUBLISHED if pair not in late]
    walk = CycleWalk([*others, *late], PLAN.tree, PLAN.cycles)
    assert messages_in(walk) == len(PUBLISHED) - 2
    assert (walk.strays, walk.too_late.total()) == (0, 0)


def test_no_more_than_so_many_messages_wait_for_an_agent_that_is_dead() -> None:
    messages = [pair for pair in PUBLISHED if pair[0].publisher != "c2/c" or pair[1].cycle < 3]
    reading = Reading(messages)
    most_held = 150
    seen = 0
    walk = CycleWalk(reading, PLAN.tree, PLAN.cycles, most_held=most_held)
    for cycle in walk:
        # One more is in hand: the one that was too many. The plant's start is none of a cycle.
        assert reading.count - seen <= most_held + 2
        seen += len(cycle.messages)
    assert seen == len(messages) - 2
    assert walk.strays == 0


def test_what_comes_when_nobody_waits_for_it_any_more_is_counted() -> None:
    late = [pair for pair in PUBLISHED if pair[0].publisher == "c2/c" and pair[1].cycle >= 3]
    others = [pair for pair in PUBLISHED if pair not in late]
    walk = CycleWalk([*others, *late], PLAN.tree, PLAN.cycles, most_held=150)
    cycles = list(walk)
    assert walk.too_late.keys() == {"c2/c"}
    found = sum(len(cycle.messages) for cycle in cycles)
    assert found + walk.too_late.total() == len(PUBLISHED) - 2
    assert walk.strays == 0


def test_strays_of_external_agents_are_counted_apart() -> None:
    port = IMPP.of("c1/a")
    strays = [
        (port, Impp(cycle, 0, "c1/a", (), power_kw=1.0, stale_cycles=0)) for cycle in (-3, 0, 4711)
    ]
    messages = [*PUBLISHED[:-1], *strays, PUBLISHED[-1]]
    theirs = CycleWalk(messages, PLAN.tree, PLAN.cycles, external=("c1/a",))
    assert messages_in(theirs) == len(PUBLISHED) - 2
    assert (theirs.strays, dict(theirs.too_late)) == (0, {"c1/a": 3})
    ours = CycleWalk(messages, PLAN.tree, PLAN.cycles)
    assert messages_in(ours) == len(PUBLISHED) - 2
    assert (ours.strays, dict(ours.too_late)) == (2, {"c1/a": 1})
