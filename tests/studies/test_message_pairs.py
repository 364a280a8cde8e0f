"""How the messages of live controllers are compared with the recorded ones."""

from __future__ import annotations

import math

import pytest
from replayed_runs import PLAN

from bus_schemas.messages import Impp
from bus_schemas.signals import IMPP
from studies.live_replay import MessagePairs

PORT = IMPP.of("c1/a")


def impp(cycle: int, power_kw: float = 50.0, incarnation: int = 0) -> Impp:
    """What an inverter's controller publishes in a cycle."""
    stamp = (cycle, 0, "c1/a", (), 0, 0, 0, incarnation)
    return Impp(*stamp, power_kw=power_kw, stale_cycles=0)


@pytest.mark.parametrize("new_first", [False, True])
def test_messages_are_compared_whichever_comes_first_up_to_the_end(new_first: bool) -> None:
    pairs = MessagePairs(PLAN.tree, ["c1/a"])
    for cycle, new_kw in ((3, 50.0), (4, math.nextafter(50.0, 60.0))):
        for is_recorded in (not new_first, new_first):
            message = impp(cycle) if is_recorded else impp(cycle, new_kw)
            pairs.take(PORT, message, is_recorded=is_recorded)
    for cycle, is_recorded in [(5, True), (2, False), (10, True)]:
        pairs.take(PORT, impp(cycle), is_recorded=is_recorded)
    pairs.take(PORT, impp(3), is_recorded=False)  # Sent twice: one too many.
    pairs.finish(10)
    found = pairs.results["c1/a"]
    kinds = {"differs": 1, "only recorded": 1, "only new": 2}
    assert (found.compared, found.differences) == (2, kinds)


def test_a_restart_in_the_recorded_run_is_named_and_is_no_difference_of_its_own() -> None:
    pairs = MessagePairs(PLAN.tree, ["c1/a"])
    for cycle, incarnation in ((4, 0), (7, 7), (8, 7)):
        pairs.take(PORT, impp(cycle, incarnation=incarnation), is_recorded=True)
        pairs.take(PORT, impp(cycle), is_recorded=False)
    pairs.finish(10)
    assert pairs.replaced == {"c1/a": {7}}
    assert not pairs.results["c1/a"].differences
