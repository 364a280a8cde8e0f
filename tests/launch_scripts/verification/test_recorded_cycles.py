"""A recording is walked through cycle by cycle, each once it is complete."""

from __future__ import annotations

from collections.abc import Iterator

from troubled_runs import TroubledRun, cloudy_profile, lockstep_run, plan_of

from bus_schemas.bus import Delivery
from bus_schemas.messages import Impp
from bus_schemas.signals import IMPP, RUN
from launch_scripts.verification.recorded_cycles import CycleWalk

PLAN = plan_of(cycles=40)
SAID = lockstep_run(PLAN, cloudy_profile(PLAN))


class Reading:
    """Deliveries that are read one by one, with a count of those that were."""

    def __init__(self, said: list[Delivery]) -> None:
        self.count = 0
        self._said = said

    def __iter__(self) -> Iterator[Delivery]:
        for delivery in self._said:
            self.count += 1
            yield delivery


def messages_in(walk: CycleWalk) -> int:
    return sum(len(cycle.messages) + len(cycle.repeated) for cycle in walk)


def test_each_cycle_comes_whole_and_in_its_order() -> None:
    walk = CycleWalk(SAID, PLAN.tree, PLAN.cycles)
    for number, cycle in enumerate(walk):
        assert cycle.number == number
        assert cycle.took_place
        expected = {
            port: message
            for port, message in SAID
            if message.cycle == number and port.signal is not RUN
        }
        assert cycle.messages == expected
        assert cycle.repeated == []
    assert walk.read == len(SAID)
    assert walk.stop_cycle == PLAN.cycles


def test_a_cycle_comes_as_soon_as_everybody_has_left_it_behind() -> None:
    reading = Reading(SAID)
    in_a_cycle = len(SAID) / PLAN.cycles
    for cycle in CycleWalk(reading, PLAN.tree, PLAN.cycles):
        assert reading.count <= (cycle.number + 4) * in_a_cycle + 20


def test_a_cycle_waits_for_an_agent_that_lags_behind() -> None:
    plan = plan_of(cycles=40, cycle_wall_ns=1_000_000)
    run = TroubledRun(plan, cloudy_profile(plan), seed=1, frozen=("c1/b", range(5, 30)))
    said = run.run()
    walk = CycleWalk(said, plan.tree, plan.cycles)
    assert messages_in(walk) == len(said) - 2
    assert walk.strays == 0


def test_no_more_than_so_many_messages_wait_for_an_agent_that_is_dead() -> None:
    said = [pair for pair in SAID if pair[0].publisher != "c2/c" or pair[1].cycle < 3]
    reading = Reading(said)
    most_held = 150
    seen = 0
    walk = CycleWalk(reading, PLAN.tree, PLAN.cycles, most_held)
    for cycle in walk:
        # One more is in hand: the one that was too many. The plant's start is none of a cycle.
        assert reading.count - seen <= most_held + 2
        seen += len(cycle.messages)
    assert seen == len(said) - 2
    assert walk.strays == 0


def test_what_comes_when_nobody_waits_for_it_any_more_is_counted() -> None:
    late = [pair for pair in SAID if pair[0].publisher == "c2/c" and pair[1].cycle >= 3]
    others = [pair for pair in SAID if pair not in late]
    walk = CycleWalk([*others, *late], PLAN.tree, PLAN.cycles, most_held=150)
    cycles = list(walk)
    assert walk.not_awaited.keys() == {"c2/c"}
    found = sum(len(cycle.messages) for cycle in cycles)
    assert found + walk.not_awaited.total() == len(SAID) - 2
    assert {agent for cycle in cycles for agent in cycle.not_awaited} == {"c2/c"}
    left_behind = [cycle.number for cycle in cycles if cycle.not_awaited]
    # In the last cycle that it had reached, more of it might have come.
    assert left_behind == list(range(left_behind[0], left_behind[-1] + 1))
    assert left_behind[0] <= 3
    assert walk.strays == 0


def test_strays_of_external_agents_are_counted_apart() -> None:
    port = IMPP.of("c1/a")
    strays = [
        (port, Impp(cycle, 0, "c1/a", (), power_kw=1.0, stale_cycles=0)) for cycle in (-3, 0, 4711)
    ]
    said = [*SAID[:-1], *strays, SAID[-1]]
    theirs = CycleWalk(said, PLAN.tree, PLAN.cycles, external=("c1/a",))
    assert messages_in(theirs) == len(SAID) - 2
    assert (theirs.strays, dict(theirs.external_strays)) == (0, {"c1/a": 3})
    ours = CycleWalk(said, PLAN.tree, PLAN.cycles)
    assert messages_in(ours) == len(SAID) - 2
    assert (ours.strays, dict(ours.external_strays)) == (3, {})


def test_cycles_after_the_end_of_the_run_did_not_take_place() -> None:
    stop = SAID[-1]
    ended_early = [*SAID[:-1], (stop[0], PLAN.run_message("stop", 38, 0))]
    walk = CycleWalk(ended_early, PLAN.tree, PLAN.cycles)
    assert [cycle.number for cycle in walk if not cycle.took_place] == [38, 39]
