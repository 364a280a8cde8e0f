"""How live controllers find the others, what must come from them, and how it is compared."""

from __future__ import annotations

import math

import pytest
from replayed_runs import PLAN, run_in_memory

from bus_schemas.codec import encode
from bus_schemas.messages import Impp
from bus_schemas.signals import IMPP, Occurrence
from recordings.read.reader import RecordedMessage
from recordings.replay.live import LiveComparison, by_cycle
from recordings.replay.live_bus import live_plan, steady_ports

SAID = run_in_memory()
PORT = IMPP.of("c1/a")


def test_live_controllers_find_each_other_and_all_others_at_one_port() -> None:
    plan = live_plan(PLAN, ("c1", "c1/a"), {"c1": 2001, "c1/a": 2002}, 1000)
    listens, connects = plan.links.endpoints("c1/a", plan.tcp_ports)
    assert listens == []
    assert set(connects) == {"tcp/127.0.0.1:1000", "tcp/127.0.0.1:2001"}
    for agent in PLAN.tree.agents()[1:]:
        alone = live_plan(PLAN, (agent,), {agent: 2001}, 1000)
        assert "tcp/127.0.0.1:1000" in alone.links.endpoints(agent, alone.tcp_ports)[1]


def test_what_must_come_in_a_cycle_is_what_came_in_the_run() -> None:
    steady = {Occurrence.CYCLE, Occurrence.TURN}
    for live in [("c1/a",), ("c1",), ("central",), ("central", "c2", "c2/d")]:
        for cycle in range(4):
            came = {
                entry.port
                for entry in SAID
                if entry.message.cycle == cycle
                and entry.port.publisher in live
                and entry.port.signal.occurrence in steady
            }
            assert steady_ports(PLAN, live, cycle) == came
            assert came


def test_messages_are_grouped_by_cycle_though_one_agent_is_ahead_and_one_is_late() -> None:
    records = [
        RecordedMessage(port, message.cycle, 0, logged_ns, message.publish_time_ns, encode(message))
        for port, message, logged_ns in SAID
    ]
    ahead = PLAN.periods.longest
    mixed = sorted(
        records, key=lambda record: record.cycle + (0 if record.port.node == "c1/a" else ahead)
    )
    groups = dict(by_cycle(mixed, ahead))
    assert list(groups) == list(range(41))
    for cycle, group in groups.items():
        assert {record.cycle for record in group} == {cycle}
    mixed.append(mixed.pop(40)._replace(cycle=1))
    assert sum(len(group) for _, group in by_cycle(mixed, ahead)) == len(SAID)


def impp(cycle: int, power_kw: float = 50.0) -> Impp:
    """What an inverter's controller publishes in a cycle."""
    return Impp(cycle, 0, "c1/a", (), power_kw=power_kw, stale_cycles=0)


@pytest.mark.parametrize("new_first", [False, True])
@pytest.mark.parametrize("new_kw", [50.0, math.nextafter(50.0, 60.0)])
def test_messages_are_compared_bit_for_bit_whichever_comes_first(
    new_kw: float, new_first: bool
) -> None:
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
