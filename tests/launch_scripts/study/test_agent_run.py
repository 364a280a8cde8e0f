"""Without a bus the agents say what they say over one."""

from __future__ import annotations

import msgspec
import pytest

from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port
from launch_scripts.preparation import RunOptions, prepare
from launch_scripts.scenario import load_scenario
from launch_scripts.simulation import MemoryRun
from launch_scripts.study.agent_run import AgentRun


@pytest.mark.parametrize(("scenario", "period_cycles"), [("oahu", (1, 1)), ("valley", (6, 3, 1))])
def test_every_message_is_the_same_as_over_the_bus_in_memory(
    scenario: str, period_cycles: tuple[int, ...]
) -> None:
    prepared = prepare(load_scenario(scenario), RunOptions(duration="20"), "bus")
    plan = msgspec.structs.replace(prepared.plan, period_cycles=period_cycles)
    over_bus: dict[tuple[Port[Message], int], Message] = {}
    without: dict[tuple[Port[Message], int], Message] = {}

    def hear(port: Port[Message], message: Message) -> None:
        if port.signal is not RUN:
            bare = msgspec.structs.replace(message, publish_time_ns=0, sequence=0)
            over_bus[port, message.cycle] = bare

    for _ in MemoryRun(plan, prepared.profile, hear).cycles():
        pass
    AgentRun(
        plan,
        prepared.profile,
        lambda port, message: without.update({(port, message.cycle): message}),
    ).run()
    assert without == over_bus
