"""Highlights of a run: its power in sixty steps, and its hardest minutes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from bus_schemas.errors import listed
from bus_schemas.tree import ROOT
from recordings.read.series import RunSeries

_STEPS: Final = 60
_MINUTES: Final = 5
_NAMED: Final = 2
"""Nodes that a sentence names at most."""

_LEAST_KW: Final = 0.05


class Curve(msgspec.Struct, frozen=True):
    """Mean power of the plant in equal steps of the run [kW]; None where no cycle is known."""

    step_s: float
    available_kw: list[float | None]
    dispatch_kw: list[float | None]
    delivered_kw: list[float | None]
    without_help_kw: list[float | None]


class HardMinute(msgspec.Struct, frozen=True):
    """A minute in which the sky made the promise hard to keep, and its hardest cycle.

    without_help_kwh: What would have been missed if each inverter were held to its share.
    missed_kwh: What was missed.
    cycle: The cycle of the minute in which most would have been missed; what follows is of it.
    noun: What the nodes are: inverters, or the clusters of a large plant.
    lacking, gave: Nodes below their share and above it, the largest difference first [kW].
    """

    cycle: int
    without_help_kwh: float
    missed_kwh: float
    missed_kw: float
    noun: str
    lacking: list[tuple[str, float]]
    gave: list[tuple[str, float]]

    def sentence(self) -> str:
        """Say who lacked power in the hardest cycle, and who gave it."""
        if not self.lacking:
            help_inside = "; inverters helped inside clusters" if self.noun == "cluster" else ""
            return f"no {self.noun} was below its share{help_inside}"
        parts = [f"{_named(self.lacking)} lacking"]
        parts.append(f"help from {_named(self.gave)}" if self.gave else "nobody had more to give")
        if self.missed_kw >= _LEAST_KW:
            parts.append(f"{self.missed_kw:,.1f} kW still missed")
        return "; ".join(parts)


class Highlights(msgspec.Struct, frozen=True):
    """The curve and the hardest minutes of a run."""

    curve: Curve
    hard_minutes: list[HardMinute]


def highlights(series: RunSeries) -> Highlights:
    """Return the curve and the hardest minutes of a run."""
    return Highlights(_curve(series), list(_hard_minutes(series)))


def _curve(series: RunSeries) -> Curve:
    span = max(1, -(-series.cycles // _STEPS))
    begins = np.arange(0, series.cycles, span)

    def means(power_kw: NDArray[np.float64]) -> list[float | None]:
        known = np.isfinite(power_kw)
        counts = np.add.reduceat(known, begins, dtype=float)
        sums = np.add.reduceat(np.where(known, power_kw, 0.0), begins)
        pairs = zip(sums, counts, strict=True)
        return [float(kw / count) if count else None for kw, count in pairs]

    return Curve(
        span * series.cycle_s,
        means(series.available_kw),
        means(series.desired_kw),
        means(series.delivered_kw),
        means(series.without_help_kw),
    )


def _hard_minutes(series: RunSeries) -> Iterator[HardMinute]:
    """Yield the minutes in which most would have been missed without help, the worst first."""
    hours = series.cycle_s / 3600.0
    missing_kw = np.maximum(series.desired_kw - series.without_help_kw, 0.0)
    counts = series.known & np.isfinite(missing_kw) & (series.desired_kw > 0.0)
    missing_kw = np.where(counts, missing_kw, 0.0)
    missed_kw = np.where(series.known, series.shortfall_kw, 0.0)
    span = max(1, round(60.0 / series.cycle_s))
    begins = np.arange(0, series.cycles, span)
    minutes_kwh = np.add.reduceat(missing_kw, begins) * hours
    for minute in np.argsort(-minutes_kwh, kind="stable")[:_MINUTES].tolist():
        cycles = slice(minute * span, (minute + 1) * span)
        if minutes_kwh[minute] <= 0.0:
            return
        row = minute * span + int(np.argmax(missing_kw[cycles]))
        lacking, gave = _sides(series, row)
        yield HardMinute(
            series.first_cycle + row,
            float(minutes_kwh[minute]),
            float(missed_kw[cycles].sum()) * hours,
            float(missed_kw[row]),
            series.noun,
            lacking,
            gave,
        )


def _sides(series: RunSeries, row: int) -> tuple[list[tuple[str, float]], list[tuple[str, float]]]:
    """Return the nodes below and above their share in a cycle, and by how much [kW]."""
    tree, power_kw = series.plan.tree, series.power_kw[row]
    sharing_kw = np.array([tree.sharing_kw(node) for node in series.inverters])
    needed_kw = float(series.desired_kw[row] + series.lost_kw[row])
    over_kw = power_kw - sharing_kw * (needed_kw / tree.rating_kw(ROOT))
    order = np.argsort(over_kw, kind="stable")
    pairs = [(series.inverters[column], float(over_kw[column])) for column in order.tolist()]
    lacking = [(node, -kw) for node, kw in pairs if kw <= -_LEAST_KW]
    gave = [(node, kw) for node, kw in reversed(pairs) if kw >= _LEAST_KW]
    return lacking, gave


def _named(nodes: Sequence[tuple[str, float]]) -> str:
    """Name the nodes with the largest powers, count the others."""
    shown = [f"{node} {kw:,.0f} kW" if kw >= 1.0 else f"{node} {kw:.1f} kW" for node, kw in nodes]
    rest = nodes[_NAMED:]
    if rest:
        others_kw = sum(kw for _, kw in rest)
        shown[_NAMED:] = [f"{len(rest)} more {others_kw:,.0f} kW"]
    return listed(shown)
