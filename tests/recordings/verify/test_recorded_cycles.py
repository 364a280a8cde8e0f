"""A recording is read cycle by cycle, each as soon as it is complete."""

from __future__ import annotations

import pytest
from recorded_runs import cloudy_profile, plan_of, published

from bus_schemas.messages import Impp
from bus_schemas.signals import IMPP, RUN
from recordings.verify.recorded_cycles import RecordedCycles

PLAN = plan_of(cycles=40)
PUBLISHED = published(PLAN, cloudy_profile(PLAN))
DECIDED = [pair for pair in PUBLISHED if pair[0].signal is not RUN]


def test_not_all_messages_wait_for_an_agent_that_has_ended() -> None:
    others = [pair for pair in PUBLISHED if pair[0].publisher != "c2/c" or pair[1].cycle < 3]
    recorded, seen = RecordedCycles(others, PLAN, 40, most_waiting=150), 0
    for cycle in recorded:
        seen += len(cycle.messages)
        assert recorded.read - seen <= 150 + 2
    assert seen == len(others) - 2


@pytest.mark.parametrize(("external", "misplaced"), [((), 3), (("c1/a",), 0)])
def test_a_device_may_send_messages_of_any_cycle(external: tuple[str, ...], misplaced: int) -> None:
    port = IMPP.of("c1/a")
    strays = [
        (port, Impp(cycle, 0, "c1/a", (), power_kw=1.0, stale_cycles=0)) for cycle in (-3, 0, 4711)
    ]
    plan = plan_of(cycles=40, external=external)
    cycles = RecordedCycles([*PUBLISHED[:-1], *strays, PUBLISHED[-1]], plan, 40)
    kept = sum(len(cycle.messages) + len(cycle.repeated) for cycle in cycles)
    assert (kept, cycles.misplaced) == (len(DECIDED), misplaced)
