"""A controller that acts on the bus's own thread, with a plant at the other end of a real link."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
import zenoh
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import dispatch, setpoint, telemetry

from agents.eager_driver import EagerDriver
from agents.loop import Loop
from agents.plan import RunPlan
from agents.process.agent_process import make_driver
from agents.team import Controller, controller
from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.signals import RESIDUAL, RUN
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import PLANT, ROOT
from bus_schemas.zenoh_bus import ZenohBus
from bus_schemas.zenoh_session import SessionSettings, open_session

PLAN = plan_of({"a": 100.0})
IN_REAL_TIME = plan_of({"a": 100.0}, cycle_wall_ns=REAL_TIME)
ROUND = -1000
FOR_EVER_S = 600.0
"""Longer than a test may take: what it sleeps for if nobody wakes it."""


class BrokenError(Exception):
    """A fault of a controller."""


class Plant:
    """The far end of a controller's link, and the controller, whose thread drives it to its end."""

    def __init__(self, session: zenoh.Session, driver: EagerDriver, ended: Future[Any]) -> None:
        self.ended = ended
        self.loop = driver.loops["a"]
        self._session = session
        self._residuals = session.declare_subscriber(PLAN.wiring.key(RESIDUAL.of("a")))

    def say(self, *deliveries: Delivery) -> None:
        for port, message in deliveries:
            self._session.put(PLAN.wiring.key(port), encode(message))

    def arm(self) -> None:
        """Open arming rounds until the controller has entered one."""
        cycle = ROUND
        while self.loop.cycle < ROUND:
            self.say(dispatch(cycle, 50.0, 100.0))
            cycle += 1
            time.sleep(0.02)

    def begin(self, plan: RunPlan) -> None:
        self.say((RUN.of(ROOT), plan.run_message("start", 0, time.monotonic_ns())))

    def hear_residual(self) -> int:
        """Wait for the controller's residual; return its cycle."""
        return RESIDUAL.decode(next(iter(self._residuals)).payload.to_bytes()).cycle


@contextmanager
def linked(plan: RunPlan, agent: Controller | None = None) -> Iterator[Plant]:
    with ExitStack() as stack:
        (port,) = stack.enter_context(reserved_ports([PLANT])).values()
        endpoint = [f"tcp/127.0.0.1:{port}"]
        settings = SessionSettings("eager-by-hand", endpoint, [])
        session = stack.enter_context(open_session(settings))
        settings = SessionSettings("eager-by-hand", [], endpoint)
        bus = ZenohBus("a", plan.wiring, settings, patience_s=FOR_EVER_S)
        stack.enter_context(bus)
        driver = EagerDriver([Loop(agent or controller(plan, "a"), plan)], bus)
        own_thread = stack.enter_context(ThreadPoolExecutor(1))
        yield Plant(session, driver, own_thread.submit(list, driver.run()))


def test_an_eager_agent_answers_and_ends_while_its_thread_sleeps() -> None:
    with linked(PLAN) as plant:
        plant.arm()
        plant.say(telemetry("a", plant.loop.cycle, 80.0))
        assert plant.hear_residual() == plant.loop.cycle
        plant.begin(PLAN)
        plant.say(dispatch(0, 50.0, 100.0), telemetry("a", 0, 80.0))
        assert plant.hear_residual() == 0
        plant.say(setpoint("a", 0, 50.0))
        plant.ended.result()


def test_the_first_deadlines_of_a_run_are_kept() -> None:
    with linked(IN_REAL_TIME) as plant:
        plant.arm()
        plant.begin(IN_REAL_TIME)
        assert plant.hear_residual() == 0, "without any telemetry"
        plant.ended.result()


def test_a_fault_on_the_bus_s_thread_ends_the_run_of_its_agent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    agent = controller(PLAN, "a")

    def fail(*_: object) -> None:
        raise BrokenError

    monkeypatch.setattr(agent, "step", fail)
    with linked(PLAN, agent) as plant:
        plant.arm()
        plant.say(telemetry("a", plant.loop.cycle, 80.0))
        with pytest.raises(BrokenError):
            plant.ended.result()


def test_an_agent_with_more_messages_than_a_queue_takes_sends_on_its_own_thread() -> None:
    for number, is_eager in ((100, True), (1_000, False)):
        plan = plan_of({f"i{leaf}": 1.0 for leaf in range(number)})
        bus = ZenohBus("central", plan.wiring, SessionSettings("many", [], []), patience_s=0.0)
        with bus:
            driver = make_driver(plan, [Loop(controller(plan, "central"), plan)], bus)
        assert isinstance(driver, EagerDriver) == is_eager
