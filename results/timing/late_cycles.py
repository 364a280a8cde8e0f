"""Every late cycle, with the agent or link that made it late and the cause.

From the last stage that was late the chain leads back to the tick: through the input that a stage
awaited last, or through one that it closed without. Of all decisions and hops in it, the one that
took longest beyond its usual time is the culprit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf, isnan
from typing import Any, Final, NamedTuple, TypeAlias

import pandas as pd

from agents.plan import RunPlan
from results.timing.measures import loop_ms
from results.timing.stages import sender_of

_STOOD_STILL_SHARE: Final = 0.5
"""Of the excess: if the machine stood still for this part of it, nothing else is to blame."""

_Row: TypeAlias = Any
_Rows: TypeAlias = dict[tuple[str, str], _Row]
"""The rows of a cycle by agent and stage."""


class LateCycle(NamedTuple):
    """A late cycle.

    loop_ms: From the tick until the last command came; NaN if the plant closed nothing.
    culprit: An agent, or for a hop `KEY to AGENT`. stage: Of the agent, or of the receiver.
    cause: `published nothing`, `decision`, `hop`, `tick` or `machine stood still`.
    ms: How long that took; infinite if nothing was published.
    stopped_ms: How long the machine stood still in the cycle; NaN if nobody watched.
    """

    cycle: int
    loop_ms: float
    culprit: str
    stage: str
    cause: str
    ms: float
    stopped_ms: float
    text: str


class _Step(NamedTuple):
    """A part of the chain, and by how much it was longer than usual [ms]."""

    excess_ms: float
    ms: float
    culprit: str
    stage: str
    cause: str

    @property
    def text(self) -> str:
        match self.cause:
            case "published nothing":
                return f"{self.culprit} published nothing in stage {self.stage}"
            case "hop":
                return f"{self.culprit} took {self.ms:.1f} ms on its way"
            case "tick":
                return f"{self.culprit} began {self.ms:.1f} ms late"
            case _:
                return f"{self.culprit} took {self.ms:.1f} ms ({self.stage})"


def late_cycles(table: pd.DataFrame, plan: RunPlan) -> list[LateCycle]:
    """Return all late cycles of a table of stages. Those of devices count by what others lacked."""
    sent = table.published.where(~table.device, table.arrived)
    ready = table.ready.where(~table.device, table.awaited_arrived)
    hop = (table.ready - table.awaited_sent).where(table.without == "")
    began = (table.ready - table.deadline).where(table.deadline != 0.0, table["first"])
    place = table.tier.astype(str) + " " + table.stage.astype(str)
    table = table.assign(
        sent=sent, decision=sent - ready, hop=hop, began=began, loop=loop_ms(table), place=place
    )
    own = table[~table.device].groupby("place")
    usual_ms = {
        (cause, str(place)): float(ms)
        for cause in ("decision", "hop")
        for place, ms in own[cause].median().dropna().items()
    }
    senders, is_late = sender_of(plan), (table.late != "") & ~table.device
    rows = table[table.cycle.isin(table.cycle[is_late])].sort_values(["cycle", "order"])
    found = []
    for cycle, its in rows.groupby("cycle"):
        places: _Rows = {(str(one.agent), str(one.stage)): one for one in its.itertuples()}
        last = [one for one in places.values() if one.late and not one.device][-1]
        without: list[str] = []
        steps = _chain(places, senders, last, usual_ms, without)
        worst, stopped_ms = max(steps, key=lambda step: step.excess_ms), float(last.stopped)
        text = worst.text + (
            f", the machine stood still for {stopped_ms:.1f} ms" if stopped_ms > 0.0 else ""
        )
        if worst.ms < inf and stopped_ms > _STOOD_STILL_SHARE * worst.excess_ms:
            worst = worst._replace(cause="machine stood still")
        loop = float(its.loop.max())
        words = worst.culprit, worst.stage, worst.cause, worst.ms
        found.append(
            LateCycle(int(str(cycle)), loop, *words, stopped_ms, "; ".join([text, *without]))
        )
    return found


def _chain(
    left: _Rows,
    senders: Mapping[str, tuple[str, str]],
    row: _Row,
    usual_ms: Mapping[tuple[str, str], float],
    without: list[str],
) -> Iterator[_Step]:
    """Follow the causes from a stage back to the tick, and note who lacked what."""
    places = dict(left)

    def sent(key: str) -> float:
        """Return when the stage that publishes a key had; infinite if it did not."""
        its = places.get(senders.get(key, ("", "")))
        return inf if its is None or isnan(its.sent) else float(its.sent)

    def step(cause: str, ms: float, culprit: str) -> Iterator[_Step]:
        if not isnan(ms):
            excess_ms = ms - usual_ms.get((cause, row.place), 0.0)
            yield _Step(excess_ms, ms, culprit, row.stage, cause)

    while row is not None:
        left.pop((row.agent, row.stage), None)
        if isnan(row.sent):
            yield from step("published nothing", inf, row.agent)
            return
        yield from step("decision", row.decision, row.agent)
        key = row.awaited
        if row.without:
            without.append(f"{row.agent} closed {row.stage} without {row.without}")
            key = max(row.without.split(", "), key=sent)
            agent, stage = senders.get(key, (key, ""))
            if (agent, stage) not in places:
                yield _Step(inf, inf, agent, stage, "published nothing")
            yield from step("hop", row.ready - sent(key), f"{key} to {row.agent}")
        elif key:
            yield from step("hop", row.hop, f"{key} to {row.agent}")
        elif row.timed:
            yield from step("tick", row.began, row.agent)
        before = [one for one in left.values() if one.agent == row.agent and one.order < row.order]
        # A stage that awaits nothing follows the one before it.
        row = left.get(senders.get(key, ("", ""))) if key else (before[-1] if before else None)
