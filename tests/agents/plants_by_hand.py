"""Small plants made by hand, run in memory, and everything that is said in them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from agents.plan import NodeNeighbourhoods, RunPlan
from agents.sequencer import Sequencer
from bus_schemas.bus import Delivery
from bus_schemas.messages import Impp, Message, Residual
from bus_schemas.signals import IMPP, RESIDUAL, Port, Signal
from launch_scripts.simulation import MemoryRun
from sim_plant.profile import Profile

M = TypeVar("M", bound=Message)

CYCLE_NS = 1_000_000_000


def plan_of(
    ratings_kw: Mapping[str, float],
    *,
    cycles: int = 1,
    period_cycles: tuple[int, ...] | None = None,
    hold_cycles: int = 3,
    neighbourhoods: tuple[NodeNeighbourhoods, ...] = (),
) -> RunPlan:
    """Plan of a run in lockstep, from the path and rating of each inverter."""
    tiers = max(leaf.count("/") + 1 for leaf in ratings_kw)
    return RunPlan(
        run_id="by-hand",
        plant="oahu",
        inverters=tuple(ratings_kw.items()),
        start_time_ns=0,
        cycle_ns=CYCLE_NS,
        cycles=cycles,
        timezone="UTC",
        regulation_capacity_kw=0.0,
        cycle_wall_ns=0,
        period_cycles=period_cycles or (1,) * tiers,
        scheme="paper",
        actuator="fraction",
        alpha_min=0.05,
        hold_cycles=hold_cycles,
        stall_timeout_s=3.0,
        neighbourhoods=neighbourhoods,
        tcp_ports={},
    )


@dataclass
class Heard:
    """All that was said in a run, by cycle and port."""

    _messages: dict[tuple[int, Port[Message]], Message] = field(default_factory=dict)

    def __call__(self, port: Port[Message], message: Message) -> None:
        assert (message.cycle, port) not in self._messages, f"{port} came twice"
        self._messages[message.cycle, port] = message

    def find(self, cycle: int, port: Port[M]) -> M | None:
        """The message of a port in a cycle, None if there was none."""
        message = self._messages.get((cycle, port))
        assert message is None or isinstance(message, port.signal.type)
        return message

    def get(self, cycle: int, port: Port[M]) -> M:
        """The message of a port in a cycle."""
        message = self.find(cycle, port)
        assert message is not None, f"no {port} in cycle {cycle}"
        return message

    def cycles(self) -> set[int]:
        """The cycles in which anything was said."""
        return {cycle for cycle, _ in self._messages}

    def of(self, signal: Signal[M]) -> Iterator[tuple[str, M]]:
        """Node and message, of all messages of a signal."""
        for (_, port), message in self._messages.items():
            if port.signal is signal:
                assert isinstance(message, signal.type)
                yield port.node, message


def hear(plan: RunPlan, mpp_kw: Sequence[Sequence[float]], dispatch_kw: Sequence[float]) -> Heard:
    """Run a plan in memory under what sun and operator do, and listen."""
    heard = Heard()
    run = MemoryRun(plan, Profile(np.array(mpp_kw), np.array(dispatch_kw)), heard)
    assert list(run.cycles()) == list(range(plan.cycles))
    assert all(sequencer.drops.total() == 0 for sequencer in run.sequencers.values())
    return heard


def report(child: str, cycle: int, impp_kw: float, residual_kw: float) -> list[Delivery]:
    """What a child says of itself in a cycle."""
    stamp = (cycle, cycle * CYCLE_NS, child, ())
    return [
        (IMPP.of(child), Impp(*stamp, power_kw=impp_kw, stale_cycles=0)),
        (RESIDUAL.of(child), Residual(*stamp, power_kw=residual_kw)),
    ]


def tell(sequencer: Sequencer[object], *deliveries: Delivery) -> dict[Port[Message], Message]:
    """Let an agent hear messages, and return what it says in answer."""
    said: dict[Port[Message], Message] = {}
    for port, message in deliveries:
        said.update(sequencer.accept(port, message))
    return said


def at(said: Mapping[Port[Message], Message], port: Port[M]) -> M:
    """The message that was said on a port."""
    message = said[port]
    assert isinstance(message, port.signal.type)
    return message
