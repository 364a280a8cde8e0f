"""What live agents are told of the run, and what must come from them."""

from __future__ import annotations

import pytest
from tapes_by_hand import PLAN, run_in_memory

from bus_schemas.codec import encode
from bus_schemas.links import explicit_links
from bus_schemas.messages import Residual
from bus_schemas.signals import (
    COMMAND,
    HELP,
    IMPP,
    REQUEST,
    RESIDUAL,
    SETPOINT,
    Occurrence,
)
from bus_schemas.tree import RECORDER
from launch_scripts.replay.arming import first_words
from launch_scripts.replay.live import by_cycle
from launch_scripts.replay.stand_in import live_plan, steady_ports
from recordings.reader import RecordedMessage

SAID = run_in_memory()


def records() -> list[RecordedMessage]:
    """A run as a tape gives it."""
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
    assert REQUEST.of("c1/a") in steady_ports(PLAN, ("c1",), 1)
    assert COMMAND.of("c1/a") in steady_ports(PLAN, ("c1/a",), 1)


def test_the_first_words_are_all_that_live_agents_need_to_close_a_round() -> None:
    words = dict(first_words(PLAN, ("c1",), records()))
    needed = {IMPP.of("c1/a"), RESIDUAL.of("c1/b"), REQUEST.of("c1"), SETPOINT.of("c1")}
    assert needed <= set(words)
    assert not any(port.publisher == "c1" for port in words)
    for port, message in words.items():
        if isinstance(message, Residual):
            assert (HELP.of(port.node) in words) == (message.power_kw < 0.0)


def test_a_port_that_was_silent_at_first_speaks_with_what_it_said_later() -> None:
    later = [
        record for record in records() if record.port is not IMPP.of("c2/d") or record.cycle > 4
    ]
    words = dict(first_words(PLAN, ("c1/a",), later))
    assert words[IMPP.of("c2/d")].cycle == 5


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
    tape = records()
    tape.append(tape.pop(40)._replace(cycle=1))
    groups = dict(by_cycle(tape, 2))
    assert sum(len(group) for group in groups.values()) == len(SAID)
