"""Every late cycle, with the agent or link that made it late and the cause.

From the last stage that was late the chain leads back to the tick: through the input that a stage
awaited last, or through one that it closed without. Of all decisions and hops in it, the one that
took longest beyond its usual time is the culprit.
"""

from __future__ import annotations

from math import inf, isnan
from typing import Any, Final, NamedTuple, TypeAlias

import pandas as pd

from agents.plan import RunPlan
from bus_schemas.tree import PLANT
from results.timing.stages import sender_of

CAUSES: Final = ("published nothing", "decision", "hop", "tick", "machine stood still")

_STOOD_STILL_SHARE: Final = 0.5
"""Of the excess: if the machine stood still for this part of it, nothing else is to blame."""

_Row: TypeAlias = Any
_Place: TypeAlias = tuple[str, str]


class LateCycle(NamedTuple):
    """A late cycle.

    loop_ms: From the tick until the last command came; NaN if the plant closed nothing.
    culprit: An agent, or for a hop `KEY to AGENT`. stage: Of the agent, or of the receiver.
    cause: One of `CAUSES`. ms: How long that took; infinite if nothing was published.
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


def late_cycles(table: pd.DataFrame, plan: RunPlan) -> list[LateCycle]:
    """Return all late cycles of a prepared table. Those of devices count by what others lacked."""
    senders, is_late = sender_of(plan), (table.late != "") & ~table.device
    usual = _usual_ms(table)
    late = table[table.cycle.isin(table.cycle[is_late].unique())].sort_values(["cycle", "order"])
    found = []
    for cycle, rows in late.groupby("cycle"):
        places: dict[_Place, _Row] = {
            (str(one.agent), str(one.stage)): one for one in rows.itertuples()
        }
        last = [one for one in places.values() if one.late and not one.device][-1]
        steps, without = _chain(places, senders, usual, last)
        worst = max(steps, key=lambda step: step.excess_ms)
        apply = places.get((PLANT, "apply"))
        loop_ms = float("nan") if apply is None else apply.ready
        stopped_ms = float(last.stopped)
        if worst.ms < inf and stopped_ms > _STOOD_STILL_SHARE * worst.excess_ms:
            worst = worst._replace(cause="machine stood still")
        text = "; ".join([_text(worst, stopped_ms), *without])
        found.append(
            LateCycle(
                int(str(cycle)),
                loop_ms,
                worst.culprit,
                worst.stage,
                worst.cause,
                worst.ms,
                stopped_ms,
                text,
            )
        )
    return found


def _usual_ms(table: pd.DataFrame) -> dict[tuple[str, str], float]:
    """Return the median decision of each stage of a tier, and the median hop before it."""
    own = table[~table.device]
    places = own.tier.astype(str) + " " + own.stage.astype(str)
    hop_ms = (own.ready - own.awaited_sent).where(own.without == "")
    found: dict[tuple[str, str], float] = {}
    for cause, ms in (("decision", own.published - own.ready), ("hop", hop_ms)):
        for place, median_ms in ms.groupby(places).median().to_dict().items():
            found[cause, str(place)] = float(median_ms)
    return found


def _chain(
    places: dict[_Place, _Row],
    senders: dict[str, _Place],
    usual: dict[tuple[str, str], float],
    row: _Row,
) -> tuple[list[_Step], list[str]]:
    """Follow the causes from a stage back to the tick; return the steps, and who lacked what."""
    steps: list[_Step] = []
    without: list[str] = []
    left = dict(places)

    def step(cause: str, ms: float, culprit: str) -> None:
        if not isnan(ms):
            usual_ms = usual.get((cause, f"{row.tier} {row.stage}"), 0.0)
            excess_ms = ms - (0.0 if isnan(usual_ms) else usual_ms)
            steps.append(_Step(excess_ms, ms, culprit, row.stage, cause))

    while row is not None:
        left.pop((row.agent, row.stage), None)
        if isnan(row.published) and isnan(row.arrived):
            steps.append(_Step(inf, inf, row.agent, row.stage, "published nothing"))
            break
        sent = row.arrived if row.device else row.published
        step("decision", sent - (row.awaited_arrived if row.device else row.ready), row.agent)
        key = row.awaited
        if row.without:
            without.append(f"{row.agent} closed {row.stage} without {row.without}")
            key = max(row.without.split(", "), key=lambda one: _sent(places, senders, one))
            sender, stage = senders.get(key, (key, ""))
            if (sender, stage) not in places:
                steps.append(_Step(inf, inf, sender, stage, "published nothing"))
            elif (sent_ms := _sent(places, senders, key)) <= row.ready:
                step("hop", row.ready - sent_ms, f"{key} to {row.agent}")
        elif key:
            step("hop", row.ready - row.awaited_sent, f"{key} to {row.agent}")
        elif row.timed:
            step("tick", row.ready - row.deadline if row.deadline else row.first, row.agent)
        before = [one for one in left.values() if one.agent == row.agent and one.order < row.order]
        # A stage that awaits nothing follows the one before it.
        row = left.get(senders.get(key, ("", ""))) if key else (before[-1] if before else None)
    return steps, without


def _sent(places: dict[_Place, _Row], senders: dict[str, _Place], key: str) -> float:
    """Return when the stage that publishes a key had published; infinite if it did not."""
    row = places.get(senders.get(key, ("", "")))
    sent = inf if row is None else row.arrived if row.device else row.published
    return inf if isnan(sent) else float(sent)


def _text(step: _Step, stopped_ms: float) -> str:
    stopped = f", the machine stood still for {stopped_ms:.1f} ms" if stopped_ms > 0.0 else ""
    match step.cause:
        case "published nothing":
            return f"{step.culprit} published nothing in stage {step.stage}{stopped}"
        case "hop":
            return f"{step.culprit} took {step.ms:.1f} ms on its way{stopped}"
        case "tick":
            return f"{step.culprit} began {step.ms:.1f} ms late{stopped}"
        case _:
            return f"{step.culprit} took {step.ms:.1f} ms ({step.stage}){stopped}"
