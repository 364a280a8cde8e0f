"""What live agents are told of the run, and what must come from them."""

from __future__ import annotations

import math

import pytest
from recordings.replay.absent_agents import live_plan, steady_ports
from replayed_runs import PLAN, run_in_memory

from bus_schemas.codec import encode
from bus_schemas.links import explicit_links
from bus_schemas.messages import Impp
from bus_schemas.signals import COMMAND, IMPP, SETPOINT, Occurrence
from bus_schemas.tree import RECORDER
from recordings.read.reader import RecordedMessage
from recordings.replay.live import LiveComparison, by_cycle
from recordings.verify.comparison import FieldDifference

SAID = run_in_memory()


def records() -> list[RecordedMessage]:
    """A run as a recorded gives it."""
    return [
        RecordedMessage(
            port,
            message.cycle,
            message.sequence,
            logged_ns,
            message.publish_time_ns,
            encode(message),
        )
        for port, message, logged_ns in SAID
    ]


def test_live_agents_find_each_other_and_the_stand_in_for_all_others() -> None:
    live = ("c1", "c1/a")
    plan = live_plan(PLAN, live, {"c1": 2001, "c1/a": 2002}, 1000)
    assert plan.tcp_ports["c1"] == 2001
    assert {port for agent, port in plan.tcp_ports.items() if agent != "c1"} == {1000}
    links = explicit_links(plan.tree)
    assert set(plan.tcp_ports) == set(links.listening)
    listens, connects = links.endpoints("c1/a", plan.tcp_ports)
    assert listens == []
    assert set(connects) == {"tcp/127.0.0.1:1000", "tcp/127.0.0.1:2001"}


@pytest.mark.parametrize("agent", PLAN.tree.agents()[1:])
def test_every_agent_connects_to_the_stand_in_for_the_recorder(agent: str) -> None:
    plan = live_plan(PLAN, (agent,), {agent: 2001}, 1000)
    _, connects = explicit_links(plan.tree).endpoints(agent, plan.tcp_ports)
    assert "tcp/127.0.0.1:1000" in connects
    assert plan.tcp_ports[RECORDER] == 1000


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


def test_the_central_controller_speaks_down_in_its_turns_alone() -> None:
    assert SETPOINT.of("c1") in steady_ports(PLAN, ("central",), 0)
    assert SETPOINT.of("c1") not in steady_ports(PLAN, ("central",), 1)
    assert SETPOINT.of("c1/a") in steady_ports(PLAN, ("c1",), 1)
    assert COMMAND.of("c1/a") in steady_ports(PLAN, ("c1/a",), 1)


def test_messages_are_grouped_by_cycle_though_one_agent_is_ahead_of_another() -> None:
    ahead = PLAN.periods.longest
    mixed = sorted(
        records(), key=lambda record: record.cycle + (0 if record.port.node == "c1/a" else ahead)
    )
    groups = list(by_cycle(mixed, ahead))
    assert [cycle for cycle, _ in groups] == list(range(41))
    for cycle, group in groups:
        assert {record.cycle for record in group} == {cycle}
    assert sum(len(group) for _, group in groups) == len(SAID)


def test_what_comes_after_its_cycle_is_not_lost() -> None:
    recorded = records()
    recorded.append(recorded.pop(40)._replace(cycle=1))
    groups = dict(by_cycle(recorded, 2))
    assert sum(len(group) for group in groups.values()) == len(SAID)


# What they say -----------------------------------------------------------------------------------


def impp(cycle: int, power_kw: float = 50.0) -> Impp:
    """What an inverter's controller states in a cycle."""
    return Impp(cycle, 0, "c1/a", (), power_kw=power_kw, stale_cycles=0)


@pytest.mark.parametrize("new_first", [False, True])
@pytest.mark.parametrize("new_kw", [50.0, math.nextafter(50.0, 60.0)])
def test_messages_are_compared_bit_for_bit_whichever_comes_first(
    new_kw: float, new_first: bool
) -> None:
    comparison, port = LiveComparison(PLAN, ["c1/a"]), IMPP.of("c1/a")
    if new_first:
        comparison.take_new(port, impp(3, new_kw))
    comparison.take_recorded(port, impp(3))
    if not new_first:
        comparison.take_new(port, impp(3, new_kw))
    comparison.conclude(10)
    account = comparison.accounts["c1/a"]
    assert account.compared == 1
    if new_kw == 50.0:
        assert not account.counts
    else:
        assert account.first is not None
        assert (account.first.kind, account.first.stage) == ("differs", "estimate")
        assert account.first.fields == (FieldDifference("power_kw", 50.0, new_kw),)


def test_a_message_without_its_counterpart_is_a_difference_up_to_the_end() -> None:
    comparison, port = LiveComparison(PLAN, ["c1/a"]), IMPP.of("c1/a")
    comparison.take_recorded(port, impp(4))
    comparison.take_new(port, impp(2))
    comparison.take_recorded(port, impp(10))
    comparison.conclude(10)
    account = comparison.accounts["c1/a"]
    assert account.counts == {"only recorded": 1, "only new": 1}
    assert account.first is not None
    assert account.first.cycle == 2


def test_a_message_that_came_twice_is_one_too_many() -> None:
    comparison, port = LiveComparison(PLAN, ["c1/a"]), IMPP.of("c1/a")
    comparison.take_recorded(port, impp(3))
    comparison.take_new(port, impp(3))
    comparison.take_new(port, impp(3))
    comparison.conclude(10)
    assert comparison.accounts["c1/a"].counts == {"only new": 1}
