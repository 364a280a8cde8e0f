"""How the messages of live controllers are compared with the recorded ones."""

from __future__ import annotations

import math

import pytest
from replayed_runs import PLAN

from bus_schemas.messages import Impp
from bus_schemas.signals import IMPP
from recordings.replay.live import LiveComparison

PORT = IMPP.of("c1/a")


def impp(cycle: int, power_kw: float = 50.0) -> Impp:
    """What an inverter's controller publishes in a cycle."""
    return Impp(cycle, 0, "c1/a", (), power_kw=power_kw, stale_cycles=0)


@pytest.mark.parametrize("new_first", [False, True])
@pytest.mark.parametrize("new_kw", [50.0, math.nextafter(50.0, 60.0)])
def test_messages_are_compared_whichever_comes_first(new_kw: float, new_first: bool) -> None:
    comparison = LiveComparison(PLAN, ["c1/a"])
    for is_recorded in (not new_first, new_first):
        message = impp(3) if is_recorded else impp(3, new_kw)
        comparison.take(PORT, message, is_recorded=is_recorded)
    comparison.finish(10)
    found = comparison.findings["c1/a"]
    assert found.compared == 1
    assert dict(found.differences) == ({} if new_kw == 50.0 else {"differs": 1})
    if found.first is not None:
        assert (found.first.stage, found.first.fields[0].new) == ("estimate", new_kw)


def test_a_message_without_counterpart_is_a_difference_up_to_the_end() -> None:
    comparison = LiveComparison(PLAN, ["c1/a"])
    for cycle, is_recorded in [(4, True), (2, False), (10, True), (3, True), (3, False)]:
        comparison.take(PORT, impp(cycle), is_recorded=is_recorded)
    comparison.take(PORT, impp(3), is_recorded=False)  # Sent twice: one too many.
    comparison.finish(10)
    found = comparison.findings["c1/a"]
    assert found.differences == {"only recorded": 1, "only new": 2}
    assert found.first is not None
    assert found.first.cycle == 2
