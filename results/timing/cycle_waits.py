"""Who waited for whom in a cycle, worked out from the publish times of its messages.

The cause of a stage is the input published last. From the plant's production, which ends a cycle,
the causes lead back to the tick: this chain made the cycle as long as it was. A wait lasts
from the publishing of the cause to the publishing of the message; it includes the hop between the
two agents and the decision.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from agents.cycle import stage_of
from bus_schemas.errors import listed
from bus_schemas.messages import Message
from bus_schemas.signals import PRODUCTION, Port
from bus_schemas.tree import ROOT
from results.timing.stage_times import MessageTimes, StageTimes


class Wait(NamedTuple):
    """A stage of an agent, from what it waited for to its own last message.

    It began when its `cause`, the input published last, was published, and ended with its last
    message; both times are after the cycle's scheduled tick [ns]. Without a cause the clock closed
    it. `without` are the keys of inputs that had not come at its deadline.
    """

    agent: str
    stage: str
    cause: Port[Message] | None
    began_ns: int
    ended_ns: int
    without: tuple[str, ...]

    @property
    def length_ns(self) -> int:
        return self.ended_ns - self.began_ns

    def in_words(self) -> str:
        """Return a phrase such as `c2/inv09 took 18.4 ms (estimate)`."""
        took = f"{self.agent} took {self.length_ns / 1e6:.1f} ms ({self.stage})"
        return f"{took}, without {listed(self.without, 3)}" if self.without else took


class CycleWaits(NamedTuple):
    """The waits of one cycle, from the scheduled tick to the plant's production.

    The `chain` made it so long; `waits` has all stages that published, those of the chain included.
    """

    cycle: int
    loop_ns: int
    chain: tuple[Wait, ...]
    waits: tuple[Wait, ...]

    @property
    def slowest(self) -> Wait:
        return max(self.chain, key=lambda wait: wait.length_ns)

    def in_words(self) -> str:
        """Say which link made the cycle long."""
        return f"cycle {self.cycle:,}: {self.loop_ns / 1e6:.1f} ms, {self.slowest.in_words()}"


def cycle_waits(messages: MessageTimes, stages: Iterable[StageTimes], cycle: int) -> CycleWaits:
    """Return the waits of a cycle that the plant has ended.

    The chain follows the causes from the plant's production back to the tick. A message that came
    too late counts up to the moment when no agent waited for it any more.
    """
    publish_ns: dict[Any, float] = messages.publish_ns.loc[cycle].to_dict()
    closed: list[tuple[str, str, Any]] = [
        (stage.agent, stage.name, stage.closed.loc[cycle])
        for stage in stages
        if cycle in stage.closed.index
    ]
    waits: dict[tuple[str, str], Wait] = {}
    for agent, stage, row in closed:
        cause, ended_ns = row.cause, int(row.last_ns)
        if not row.awaits:  # It follows the agent's stage before it.
            before = [one for who, _, one in closed if who == agent and one.last_ns < row.first_ns]
            cause = max(before, key=lambda one: one.last_ns).message if before else None
        began_ns = 0 if cause is None else min(int(publish_ns[cause]), ended_ns)
        waits[agent, stage] = Wait(agent, stage, cause, began_ns, ended_ns, row.without)
    left, chain = dict(waits), list[Wait]()
    message: Port[Message] | None = PRODUCTION.of(ROOT)
    while message is not None:
        wait = left.pop((message.publisher, stage_of(message, messages.plan.tree)), None)
        if wait is None:
            break
        ended_ns = int(publish_ns[message])
        if chain:
            ended_ns = min(ended_ns, chain[-1].ended_ns)
        began_ns = min(wait.began_ns, ended_ns)
        chain.append(wait._replace(began_ns=began_ns, ended_ns=ended_ns))
        message = wait.cause
    return CycleWaits(cycle, chain[0].ended_ns, tuple(chain[::-1]), tuple(waits.values()))
