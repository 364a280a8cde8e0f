"""The clocks of a run's other hosts: offset and uncertainty, estimated from its messages.

A message that goes there and one that comes back in a cycle bound the offset, as in NTP: half the
difference of their hops, within half of their sum. The cycle with the shortest ones counts. Hops
between hosts are measured by no one clock, so no row shows them.
"""

from __future__ import annotations

from math import nan

import msgspec
import pandas as pd

from agents.plan import RunPlan


class HostClock(msgspec.Struct, frozen=True, kw_only=True):
    """How far the times of a host are ahead of the launcher's, after its processes set them.

    NaN: no messages went both ways.
    """

    host: str
    offset_ms: float
    uncertainty_ms: float


def clocks_of(table: pd.DataFrame, plan: RunPlan) -> tuple[HostClock, ...]:
    """Return the clock of each other host, from the rows of a prepared table."""
    host = plan.access.addresses
    own = {agent: host.get(agent, "") for agent in plan.tree.agents()}
    sender = {str(port): own.get(port.publisher, "") for port in plan.wiring.ports}
    rows = table[table.across & (table.without == "")]
    hop = rows.ready - rows.awaited_sent
    here, there = rows.agent.astype(str).map(own), rows.awaited.astype(str).map(sender)
    found = []
    for name in sorted({*own.values()} - {""}):
        to_ms = hop[(here == name) & (there == "")].groupby(rows.cycle).min()
        back_ms = hop[(here == "") & (there == name)].groupby(rows.cycle).min()
        both = pd.DataFrame({"to": to_ms, "back": back_ms}).dropna()
        # The clock is corrected on the way: the two hops must be of one cycle.
        pairs = [(float(there_ms), float(here_ms)) for there_ms, here_ms in both.to_numpy()]
        to, back = min(pairs, key=sum, default=(nan, nan))
        clock = HostClock(host=name, offset_ms=(to - back) / 2.0, uncertainty_ms=(to + back) / 2.0)
        found.append(clock)
    return tuple(found)
