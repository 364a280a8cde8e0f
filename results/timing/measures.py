"""Figures of timing: what the tidy table of stages comes to, by tier, agent and link [ms]."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from agents.plan import RunPlan
from bus_schemas.tree import PLANT
from results.timing.stages import OVERRUN, SILENT, WITHOUT

Floats = NDArray[np.float64]

LOOP: Final = "all commands"
LEVELS: Final = ("tier", "agent", "link")
COUNTS: Final = ["missed_deadlines", "missing_inputs", "overruns", "skipped_cycles"]
STATISTICS: Final = {"min": 0.0, "p50": 0.5, "p99": 0.99, "p99.9": 0.999, "max": 1.0}

BARS: Final = " ▁▂▃▄▅▆▇█"
_BINS: Final = 16


def _ready(table: pd.DataFrame) -> pd.Series:
    """When stages could close; of a device, only when its answer arrived is known."""
    return table.ready.where(~table.device, table.arrived)


def _hop(table: pd.DataFrame) -> pd.Series:
    """How long the input that completed a stage was on its way, where its receiver was idle."""
    spoke = table.groupby("agent", observed=True).published.shift()
    spoke -= table.cycle_ms * table.groupby("agent", observed=True).cycle.diff()
    is_hop = (table.without == "") & ~table.device & ~table.across & ~(spoke > table.ready)
    return (table.ready - table.awaited_sent).where(is_hop)


def _gap(table: pd.DataFrame, column: str) -> pd.Series:
    """From one last message of an agent in a cycle to that of the next cycle."""
    last = table[table.is_last]
    by = last.groupby("agent", observed=True)
    gap = by[column].diff() + last.cycle_ms * by.cycle.diff()
    return gap.where(by.cycle.diff() == 1)


MEASURES: Final[dict[str, tuple[str, Callable[[pd.DataFrame], pd.Series]]]] = {
    "loop": (
        "from the plant's scheduled tick until its last command came, or its deadline passed",
        lambda t: _ready(t).where((t.agent == PLANT) & (t.stage == "apply")),
    ),
    "command": (
        "from the plant's scheduled tick to the publishing of each command",
        lambda t: t.published.where((t.stage == "actuate") & ~t.device),
    ),
    "decision": (
        "from the moment when a stage could close to its last message",
        lambda t: (t.published - t.ready).where(~t.device),
    ),
    "hop": ("from the publishing of the input that completed a stage to when it could close", _hop),
    "lateness": (
        "from the scheduled time of what the clock closes to its first message",
        lambda t: (t["first"] - t.deadline.where(~t.timed, 0.0)).where(
            (t.timed | (t.without != "")) & ~t.device
        ),
    ),
    "age": (
        "from the publishing of the oldest input to when the stage could close",
        lambda t: (t.ready - t.oldest).where(~t.device),
    ),
    "response": (
        "of a device, seen by the recorder: from its last input to its own last message",
        lambda t: (t.arrived - t.awaited_arrived).where(t.device),
    ),
    "gap sent": (
        "from the last message of a cycle to that of the next one, when they were published",
        lambda t: _gap(t, "published"),
    ),
    "gap received": ("the same, when they arrived at the recorder", lambda t: _gap(t, "arrived")),
}
"""What is measured, in the order in which it is reported: its meaning, and its value in each row.
docs/timing.md has the definitions."""


def prepared(table: pd.DataFrame, plan: RunPlan) -> pd.DataFrame:
    """Add what measures need: whether a hop is `across` hosts, and a stage the agent's last one."""
    host = plan.access.addresses
    key_host = {str(port): host.get(port.publisher, "") for port in plan.wiring.ports}
    there = [key_host.get(key, "") for key in table.awaited.astype(str)]
    here = [host.get(agent, "") for agent in table.agent.astype(str)]
    last = table.groupby("agent", observed=True).order.transform("max")
    return table.assign(
        across=(table.awaited != "") & (np.array(there) != here),
        is_last=table.order == last,
        cycle_ms=plan.timing.cycle_wall_ns / 1e6,
    )


def _labels(table: pd.DataFrame, measure: str, level: str) -> pd.Series:
    """Return what each row of the table is reported under."""
    tier, agent, stage = (table[name].astype(str) for name in ("tier", "agent", "stage"))
    if measure == "loop":
        return pd.Series(LOOP, table.index)
    if measure == "hop":
        key = table.awaited.astype(str)
        of_signal = key.str.rpartition("/")[2]
        return {"tier": of_signal, "agent": of_signal + " to " + agent}.get(
            level, key + " to " + agent
        )
    name = agent if level == "agent" or measure == "response" else tier
    return name if measure.startswith("gap") else name + " " + stage


def durations(table: pd.DataFrame, level: str) -> Iterator[tuple[str, str, Floats]]:
    """Yield measure, row and durations [ms] of a prepared table, sorted.

    A duration below 0 cannot be: two clocks disagree, and it is left out.
    """
    for measure, (_, values_of) in MEASURES.items():
        if (level == "link" and measure != "hop") or (level != "tier" and measure == "loop"):
            continue
        ms = values_of(table).dropna()
        rows = table.loc[ms.index]
        ms, rows = ms[ms >= 0.0], rows[ms >= 0.0]
        labels = _labels(rows, measure, level)
        for of, own in ms.groupby(labels, sort=False):
            yield measure, str(of), np.sort(own.to_numpy())


def statistics(table: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each measure by tier, agent and link: count, percentiles, and a histogram.

    A percentile is the least duration that this share of all durations does not exceed.
    """
    quantiles, names = list(STATISTICS.values()), [f"{name}_ms" for name in STATISTICS]
    found: dict[tuple[str, str], dict[str, Floats]] = {}
    for level in LEVELS:
        for measure, of, ms in durations(table, level):
            found.setdefault((level, measure), {})[of] = ms
    rows = []
    for (level, measure), own in found.items():
        edges = bins(min(ms[0] for ms in own.values()), max(ms[-1] for ms in own.values()))
        for of, ms in own.items():
            figures = np.quantile(ms, quantiles, method="inverted_cdf")
            row = {"by": level, "measure": measure, "of": of, "count": len(ms)}
            shape = {"histogram": text_histogram(ms, edges)}
            rows.append(row | dict(zip(names, map(float, figures), strict=True)) | shape)
    return pd.DataFrame(rows)


def bins(least_ms: float, most_ms: float) -> Floats:
    """Return the edges of the bins of a histogram, equally wide on a logarithmic axis."""
    least_ms = max(least_ms, 1e-3)
    return np.geomspace(least_ms, max(most_ms, 1.001 * least_ms), _BINS + 1)


def text_histogram(ms: Floats, edges: Floats) -> str:
    """Return a bar for each bin, its height by the logarithm of the count: one duration is seen."""
    counts, _ = np.histogram(np.clip(ms, edges[0], edges[-1]), edges)
    heights = np.log1p(counts) / max(np.log1p(counts).max(), 1.0) * (len(BARS) - 1)
    return "".join(BARS[int(np.ceil(height))] for height in heights)


def counts(table: pd.DataFrame) -> pd.DataFrame:
    """Return for each of our agents how often it missed deadlines and inputs, overran, skipped."""
    own = table[~table.device]
    by = [own.agent.astype(str).rename("agent")]
    lacking = own.without != ""
    is_silent = own[own.late == SILENT].drop_duplicates(["cycle", "agent"])
    return (
        pd.DataFrame(
            {
                "missed_deadlines": (own.late == WITHOUT).groupby(by).sum(),
                "missing_inputs": (own.without.str.count(", ") + lacking).groupby(by).sum(),
                "overruns": (own.late == OVERRUN).groupby(by).sum(),
                "skipped_cycles": is_silent.groupby(is_silent.agent.astype(str)).size(),
            }
        )
        .fillna(0)
        .astype(int)
        .rename_axis("agent")
        .reset_index()
    )
