"""One agent of a small plant, message by message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from plans_by_hand import CYCLE_NS

from agents.agent import Agent
from agents.loop import Loop
from agents.plan import RunPlan
from agents.team import controller
from bus_schemas.bus import Delivery
from bus_schemas.messages import (
    Command,
    Dispatch,
    HelpGiven,
    Impp,
    Memory,
    Message,
    Meter,
    Residual,
    Setpoint,
    Telemetry,
)
from bus_schemas.signals import (
    COMMAND,
    DISPATCH,
    IMPP,
    MEMORY,
    METER,
    RESIDUAL,
    SETPOINT,
    TELEMETRY,
    Port,
)
from bus_schemas.tree import CENTRAL, PLANT, ROOT, agent_name, parent_of

M = TypeVar("M", bound=Message)


class AtWork:
    """An agent, or the controller of a name, in its loop, in cycle 0.

    Stages close as soon as they are complete.
    """

    def __init__(self, plan: RunPlan, agent: str | Agent[Any]) -> None:
        made = controller(plan, agent) if isinstance(agent, str) else agent
        self.loop: Loop[Any] = Loop(made, plan)
        self.loop.begin(0, 0)
        self._now_ns = 0

    def hear(self, *deliveries: Delivery) -> dict[Port[Message], Message]:
        """Let it hear messages, and return what it sends in answer."""
        for port, message in deliveries:
            self.loop.hear(port, message, self._now_ns)
        sent: dict[Port[Message], Message] = {}
        while (some := self.loop.close_stage(self._now_ns)) is not None:
            sent.update(some)
        return sent

    def at_deadline(self, stage: str = "") -> dict[Port[Message], Message]:
        """Let the deadline of the open stage pass, and return what it sends."""
        assert stage in {"", self.loop.stage}
        assert self.loop.deadline_ns is not None
        self._now_ns = self.loop.deadline_ns
        sent = dict(self.loop.close_stage(self._now_ns, is_overdue=True) or ())
        return sent | self.hear()


def at(sent: Mapping[Port[Message], Message], port: Port[M]) -> M:
    """The message that was sent on a port."""
    message = sent[port]
    assert isinstance(message, port.signal.type)
    return message


# Messages by hand ---------------------------------------------------------------------------------


def head(cycle: int, source: str) -> tuple[int, int, str, tuple[str, ...]]:
    return cycle, cycle * CYCLE_NS, source, ()


def dispatch(
    cycle: int, power_kw: float, plant_rating_kw: float, regulation_kw: float = 0.0
) -> Delivery:
    """What the operator wants."""
    message = Dispatch(
        *head(cycle, PLANT),
        power_kw=power_kw,
        plant_rating_kw=plant_rating_kw,
        commitment_kw=power_kw - regulation_kw,
        regulation_kw=regulation_kw,
    )
    return DISPATCH.of(ROOT), message


def meter(cycle: int, power_kw: float) -> Delivery:
    return METER.of(ROOT), Meter(*head(cycle, PLANT), power_kw=power_kw)


def memory(cycle: int) -> Delivery:
    """What a central controller without a past states."""
    words = head(cycle, CENTRAL)
    return MEMORY.of(ROOT), Memory(*words, correction_kw=0.0, error_kw=0.0, expected_kw=())


def telemetry(node: str, cycle: int, power_kw: float, alpha: float = 1.0) -> Delivery:
    """What an inverter of 100 kW measured."""
    message = Telemetry(*head(cycle, PLANT), power_kw=power_kw, alpha=alpha, limit_kw=100.0)
    return TELEMETRY.of(node), message


def setpoint(
    node: str,
    cycle: int,
    power_kw: float,
    share_kw: float | None = None,
    help_given: tuple[HelpGiven, ...] = (),
) -> Delivery:
    """What a parent wants of a node: by default its share."""
    share_kw = power_kw if share_kw is None else share_kw
    words = head(cycle, agent_name(parent_of(node)))
    message = Setpoint(*words, power_kw=power_kw, share_kw=share_kw, help_given=help_given)
    return SETPOINT.of(node), message


def impp(node: str, cycle: int, power_kw: float) -> Delivery:
    """What a node could give."""
    return IMPP.of(node), Impp(*head(cycle, agent_name(node)), power_kw=power_kw, stale_cycles=0)


def report(node: str, cycle: int, impp_kw: float, residual_kw: float) -> list[Delivery]:
    """What a node reports in a cycle."""
    residual = Residual(*head(cycle, agent_name(node)), power_kw=residual_kw)
    return [impp(node, cycle, impp_kw), (RESIDUAL.of(node), residual)]


def command(leaf: str, cycle: int, alpha: float) -> Delivery:
    """What an inverter of 100 kW is commanded, with half of it as the limit after its revert."""
    message = Command(
        *head(cycle, leaf), alpha=alpha, power_kw=100.0 * alpha, revert_kw=50.0 * alpha
    )
    return COMMAND.of(leaf), message
