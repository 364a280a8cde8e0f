"""A recording is read cycle by cycle, each as soon as it is complete."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import pytest
from recorded_runs import cloudy_profile, plan_of, published

from bus_schemas.bus import Delivery
from bus_schemas.messages import Impp
from bus_schemas.signals import IMPP, RUN
from recordings.verify.recorded_cycles import RecordedCycles

PLAN = plan_of(cycles=40)
PUBLISHED = published(PLAN, cloudy_profile(PLAN))
DECIDED = [pair for pair in PUBLISHED if pair[0].signal is not RUN]

IS_LATE = [pair[0].publisher == "c2/c" and pair[1].cycle >= 3 for pair in PUBLISHED]
LATE = [pair for pair, is_late in zip(PUBLISHED, IS_LATE, strict=True) if is_late]
OTHERS = [pair for pair, is_late in zip(PUBLISHED, IS_LATE, strict=True) if not is_late]


class Reading:
    """Messages that are read one by one, with a count of those that were."""

    def __init__(self, messages: Iterable[Delivery]) -> None:
        self.count = 0
        self._messages = messages

    def __iter__(self) -> Iterator[Delivery]:
        for delivery in self._messages:
            self.count += 1
            yield delivery


def count(cycles: RecordedCycles) -> int:
    return sum(len(cycle.messages) + len(cycle.repeated) for cycle in cycles)


def test_each_cycle_comes_whole_and_soon_and_in_its_order() -> None:
    reading = Reading(PUBLISHED)
    cycles = list[int]()
    for cycle in RecordedCycles(reading, PLAN, 40):
        cycles.append(cycle.number)
        assert cycle.messages == {
            port: message for port, message in DECIDED if message.cycle == cycle.number
        }
        assert reading.count <= (cycle.number + 23) * len(PUBLISHED) / PLAN.cycles + 20
    assert cycles == list(range(40))


def test_not_all_messages_wait_for_an_agent_that_has_ended() -> None:
    reading, seen = Reading(OTHERS), 0
    for cycle in RecordedCycles(reading, PLAN, 40, most_waiting=150):
        seen += len(cycle.messages)
        assert reading.count - seen <= 150 + 2
    assert seen == len(OTHERS) - 2


@pytest.mark.parametrize(("external", "misplaced"), [((), 3), (("c1/a",), 0)])
def test_a_device_of_the_user_may_send_messages_of_any_cycle(
    external: tuple[str, ...], misplaced: int
) -> None:
    port = IMPP.of("c1/a")
    strays = [
        (port, Impp(cycle, 0, "c1/a", (), power_kw=1.0, stale_cycles=0)) for cycle in (-3, 0, 4711)
    ]
    plan = plan_of(cycles=40, external=external)
    cycles = RecordedCycles([*PUBLISHED[:-1], *strays, PUBLISHED[-1]], plan, 40)
    assert count(cycles) == len(DECIDED)
    assert cycles.misplaced == misplaced
