"""Who waited for whom in a cycle, worked out from the publish times of its messages.

The cause of a stage is the input published last. From the plant's production, which ends a cycle,
the causes lead back to the tick: this chain made the cycle as long as it was. A wait lasts
from the publishing of the cause to the publishing of the message; it includes the hop between the
two agents and the decision.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from bus_schemas.errors import listed
from bus_schemas.signals import PRODUCTION
from bus_schemas.tree import ROOT
from results.timing.stage_times import Block, RunGraph


class CycleWaits(NamedTuple):
    """The waits of one cycle, from the scheduled tick to the plant's production.

    `waits` has a row for each stage that published: agent, name (of the stage), cause (a key;
    empty: the clock closed it), began_ms and ended_ms after the tick, and text, a phrase such as
    `c2/inv09 took 18.4 ms (estimate)`. `chain` has those that made the cycle so long, in order.
    The machine stood still for `stopped_ms` meanwhile.
    """

    cycle: int
    chain: pd.DataFrame
    waits: pd.DataFrame
    stopped_ms: float = 0.0

    @property
    def length_ms(self) -> float:
        return float(self.chain.ended_ms.iloc[-1])

    def in_words(self) -> str:
        """Say which link made the cycle long."""
        slowest = (self.chain.ended_ms - self.chain.began_ms).to_numpy().argmax()
        text = f"cycle {self.cycle:,}: {self.length_ms:.1f} ms, {self.chain.text.iloc[slowest]}"
        stopped = f"; the machine stood still for {self.stopped_ms:.1f} ms"
        return text + stopped if self.stopped_ms else text


def cycle_waits(graph: RunGraph, block: Block, cycle: int) -> CycleWaits:
    """Return the waits of a cycle that the plant has ended.

    A message that came too late counts up to the moment when no agent waited for it any more.
    """
    sent = block.messages[block.messages.cycle == cycle].set_index("port").publish_ns
    sent_ms = (sent - cycle * graph.plan.timing.cycle_wall_ns) / 1e6
    waits = block.closed[block.closed.cycle == cycle].sort_values("stage").set_index("stage")
    # A stage that awaits nothing follows the agent's stage before it.
    before = waits.groupby("agent").message.shift()
    cause = waits.cause.where(waits.awaits, before)
    waits["ended_ms"] = (waits.last_ns - waits.tick_ns) / 1e6
    waits["began_ms"] = np.fmin(sent_ms.reindex(cause).fillna(0.0).to_numpy(), waits.ended_ms)
    waits["cause"] = ["" if pd.isna(at) else str(graph.messages[int(at)]) for at in cause]
    chain: list[pd.Series] = []
    left, port, until_ms = set(waits.index), graph.messages.index(PRODUCTION.of(ROOT)), np.inf
    while (stage := graph.ports.stage[port]) in left:
        left.remove(stage)
        until_ms = min(sent_ms[port], until_ms)
        link = waits.loc[stage].copy()
        link["began_ms"], link["ended_ms"] = min(link.began_ms, until_ms), until_ms
        chain.insert(0, link)
        if cause.isna()[stage]:
            break
        port = int(cause[stage])
    without = block.late[block.late.cycle == cycle].groupby("stage").input.agg(list)
    chain_table = _with_texts(graph, pd.DataFrame(chain), without)
    return CycleWaits(cycle, chain_table, _with_texts(graph, waits, without))


def _with_texts(graph: RunGraph, waits: pd.DataFrame, without: pd.Series) -> pd.DataFrame:
    """Return waits with their texts."""
    texts = []
    for stage, one in waits.iterrows():
        took = f"{one.agent} took {one.ended_ms - one.began_ms:.1f} ms ({one['name']})"
        missing = sorted(str(graph.messages[port]) for port in without.get(stage, ()))
        texts.append(f"{took}, without {listed(missing, 3)}" if missing else took)
    return waits[["agent", "name", "cause", "began_ms", "ended_ms"]].assign(text=texts)
