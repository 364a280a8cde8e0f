"""A controller that acts on the bus's own thread, with a plant at the other end of a real link."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import zenoh
from plans_by_hand import plan_of
from plants_by_hand import dispatch, telemetry

from agents.eager_driver import EagerDriver
from agents.loop import AgentLoop
from agents.team import controller
from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.tree import PLANT
from bus_schemas.zenoh_bus import SessionSettings, ZenohBus
from launch_scripts.launcher.tcp_ports import reserved_ports

PLAN = plan_of({"a": 100.0})
ROUND = -1000


class BrokenError(Exception):
    """A fault of a controller."""


class FarEnd:
    """The plant's end of the link: what it hears, and what it says."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self.residuals = session.declare_subscriber(PLAN.keys.plant + "/a/residual")

    def say(self, *deliveries: Delivery) -> None:
        for port, message in deliveries:
            self._session.put(PLAN.keys.key(port), encode(message))

    def say_until_heard(self, driver: EagerDriver) -> None:
        """Open arming rounds until the first dispatch gets through."""
        cycle = ROUND
        for _ in driver.run():
            if driver.loops["a"].cycle >= ROUND:
                return
            cycle += 1
            self.say(dispatch(cycle, 50.0, 100.0))


@pytest.fixture
def linked() -> Iterator[tuple[FarEnd, ZenohBus]]:
    with ExitStack() as stack:
        (port,) = stack.enter_context(reserved_ports([PLANT])).values()
        endpoint = [f"tcp/127.0.0.1:{port}"]
        settings = SessionSettings("eager-by-hand", endpoint, [])
        session = stack.enter_context(zenoh.open(settings.config()))
        settings = SessionSettings("eager-by-hand", [], endpoint)
        yield (
            FarEnd(session),
            stack.enter_context(ZenohBus("a", PLAN.keys, PLAN.wiring, settings, patience_s=0.05)),
        )


def test_it_answers_while_its_own_thread_does_nothing(linked: tuple[FarEnd, ZenohBus]) -> None:
    plant, bus = linked
    driver = EagerDriver(AgentLoop(controller(PLAN, "a"), PLAN), bus)
    plant.say_until_heard(driver)
    # Nobody takes a turn of the driver from here on.
    plant.say(telemetry("a", driver.loops["a"].cycle, 80.0))
    answer = next(iter(plant.residuals))
    assert answer.payload.to_bytes()


def test_a_fault_on_the_bus_s_thread_ends_the_run_of_its_agent(
    linked: tuple[FarEnd, ZenohBus],
) -> None:
    plant, bus = linked
    agent: Any = controller(PLAN, "a")

    def fail(*_: object) -> None:
        raise BrokenError

    agent.step = fail
    driver = EagerDriver(AgentLoop(agent, PLAN), bus)
    plant.say_until_heard(driver)
    plant.say(telemetry("a", driver.loops["a"].cycle, 80.0))
    with pytest.raises(BrokenError):
        list(driver.run())
