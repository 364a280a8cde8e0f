"""Figures of timing: what the tidy table of stages comes to, by tier, agent and link [ms]."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bus_schemas.tree import PLANT

Floats = NDArray[np.float64]

LOOP: Final = "all commands"
STATISTICS: Final = {"min": 0.0, "p50": 0.5, "p99": 0.99, "p99.9": 0.999, "max": 1.0}

FEW: Final = 100
"""The p99 of fewer durations is the longest one: a single one must not decide."""

_BINS: Final = 16

MEANINGS: Final = {
    "loop": "from the plant's scheduled tick until its last command came, or its deadline passed",
    "decision": "from the moment when a stage could close to its last message",
    "hop": "from the publishing of the input that completed a stage to when it could close",
    "lateness": "from the scheduled time of what the clock closes to its first message",
    "age": "from the publishing of the oldest input to when the stage could close",
    "response": "of a device, seen by the recorder: from its last input to its own last message",
    "gap sent": "from an agent's last message of a cycle to that of the next, when published",
    "gap received": "the same, when they arrived at the recorder",
}
"""What is measured, in the order in which it is reported; docs/timing.md has the columns."""


def measured(table: pd.DataFrame) -> dict[str, pd.Series]:
    """Return each measure in the rows of a table of stages; NaN where it does not apply."""
    own, agent, sent = ~table.device, table.agent, table.tick + table.published
    busy_until = sent.groupby(agent, observed=True).shift() - table.tick
    is_hop = own & ~table.across & (table.without == "") & ~(busy_until > table.ready)
    last = table[table.order == table.groupby("agent", observed=True).order.transform("max")]
    is_next = last.cycle.groupby(last.agent, observed=True).diff() == 1

    def gap(times: pd.Series) -> pd.Series:
        at = last.tick + times[last.index]
        return at.groupby(last.agent, observed=True).diff().where(is_next)

    due = table.deadline.where(~table.timed, 0.0)
    return {
        "loop": loop_ms(table),
        "decision": (table.published - table.ready).where(own),
        "hop": (table.ready - table.awaited_sent).where(is_hop),
        "lateness": (table["first"] - due).where(own & (table.timed | (table.without != ""))),
        "age": (table.ready - table.oldest).where(own),
        "response": (table.arrived - table.awaited_arrived).where(table.device),
        "gap sent": gap(table.published),
        "gap received": gap(table.arrived),
    }


def loop_ms(table: pd.DataFrame) -> pd.Series:
    """Return the loop time in the plant's rows; of a device only the arrival of its answer."""
    ready = table.ready.where(~table.device, table.arrived)
    return ready.where((table.agent == PLANT) & (table.stage == "apply"))


def durations(table: pd.DataFrame) -> Iterator[tuple[str, str, str, Floats]]:
    """Yield level, measure, row and durations [ms] of a table of stages, sorted.

    A duration below 0 cannot be: two clocks disagree, and it is left out.
    """
    for measure, found in measured(table).items():
        ms = found[found >= 0.0]
        rows = table.loc[ms.index, ["tier", "agent", "stage", "awaited"]].astype(str)
        for level, labels in _labels(measure, rows).items():
            for of, its in ms.groupby(labels, sort=False):
                yield level, measure, str(of), np.sort(its.to_numpy())


def _labels(measure: str, rows: pd.DataFrame) -> dict[str, pd.Series]:
    """Return what rows are reported under, by level."""
    if measure == "loop":
        return {"tier": pd.Series(LOOP, rows.index)}
    if measure == "hop":
        signal, to = rows.awaited.str.rpartition("/")[2], " to " + rows.agent
        return {"tier": signal, "agent": signal + to, "link": rows.awaited + to}
    stage = "" if measure.startswith("gap") else " " + rows.stage
    tier = rows.agent if measure == "response" else rows.tier
    return {"tier": tier + stage, "agent": rows.agent + stage}


def statistics(table: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each measure by tier, agent and link: count, percentiles, and a histogram.

    A percentile is the least duration that this share of all durations does not exceed; `judged_ms`
    is the longest duration but 1 % of them, and but one of fewer than a hundred.
    """
    quantiles, names = list(STATISTICS.values()), [f"{name}_ms" for name in STATISTICS]
    rows, all_ms = [], []
    for level, measure, of, ms in durations(table):
        figures = np.quantile(ms, quantiles, method="inverted_cdf")
        row = {"by": level, "measure": measure, "of": of, "count": len(ms)}
        row["judged_ms"] = float(ms[-1 - max(len(ms) // FEW, len(ms) > 1)])
        rows.append(row | dict(zip(names, map(float, figures), strict=True)))
        all_ms.append(ms)
    found = pd.DataFrame(rows)
    histograms = {}
    for _, its in found.groupby(["by", "measure"]):
        edges = bins(its)
        for at in its.index.tolist():
            histograms[at] = np.histogram(np.clip(all_ms[at], *edges[[0, -1]]), edges)[0].tolist()
    return found.assign(histogram=pd.Series(histograms))


def bins(rows: pd.DataFrame) -> Floats:
    """Return the edges of the bins of the histograms of rows: their logarithms are equally far."""
    least_ms = max(rows.min_ms.min(), 1e-3)
    return np.geomspace(least_ms, max(rows.max_ms.max(), 1.001 * least_ms), _BINS + 1)
