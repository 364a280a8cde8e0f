"""A recording is read cycle by cycle, each as soon as it is complete."""

from __future__ import annotations

from recorded_runs import cloudy_profile, plan_of, published

from recordings.verify.recorded_cycles import RecordedCycles

PLAN = plan_of(cycles=40)
PUBLISHED = published(PLAN, cloudy_profile(PLAN))


def test_not_all_messages_wait_for_an_agent_that_has_ended() -> None:
    others = [pair for pair in PUBLISHED if pair[0].publisher != "c2/c" or pair[1].cycle < 3]
    recorded, seen = RecordedCycles(others, PLAN, 40, most_waiting=150), 0
    for cycle in recorded:
        seen += len(cycle.messages)
        assert recorded.read - seen <= 150 + 2
    assert seen == len(others) - 2
