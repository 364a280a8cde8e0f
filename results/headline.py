"""The last lines of a run in the terminal: how the promise was kept, and when it was hard."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.console import Console

from bus_schemas.errors import printable
from results.figures import Figures
from results.highlights import Curve, HardMinute
from results.run_document import RunDocument

_BLOCKS: Final = " ▁▂▃▄▅▆▇█"
_PLAIN_BLOCKS: Final = " .:-=+*#@"
"""From nothing to the most; the plain ones are for terminals that have no others."""

_BESIDE_CURVE: Final = 32
"""Columns that name and span of a curve take."""


def print_headline(summary: RunDocument, console: Console) -> None:
    """Print how the promise was kept with help and without, the run's power, the worst minute."""
    if summary.figures is None or summary.highlights is None:
        return
    curve, hard_minutes = summary.highlights.curve, summary.highlights.hard_minutes
    start = pd.Timestamp(summary.sim_start.rsplit(" ", 1)[0])
    can_draw = (console.encoding or "").lower().startswith("utf")
    lines = ["", headline(summary.figures), *curve_lines(curve, can_draw, console.width)]
    if hard_minutes:
        lines.append(f"hardest at {minute_line(hard_minutes[0], start, summary.cycle_s)}")
    for line in lines:
        wraps = not console.is_terminal  # In a terminal, between words.
        console.print(printable(line), markup=False, highlight=False, soft_wrap=wraps)


def headline(figures: Figures) -> str:
    """Say how much of the promise was missed, what the sky denied, and what no help would give."""
    missed, alone = figures["control-caused"], figures["without-help"]
    if missed is None:
        return "nothing was promised"
    parts = [f"missed {percent(missed)} of the promise"]
    if (metered := figures["metered-control-caused"]) is not None:
        parts[0] += f" ({percent(metered)} by the plant's meter)"
    if alone is not None:
        parts.append(f"without help between inverters {percent(alone)}")
    if (without_kwh := figures["without-storage-energy"]) is not None:
        given_kwh = without_kwh - (figures["shortfall-energy"] or 0.0)
        share = 100.0 * given_kwh / (figures["dispatched-energy"] or 1.0)
        # Its own shortfall may be larger: what it took late, or gave too little of.
        parts.append(f"storage {'cost' if share < 0.0 else 'gave'} {percent(abs(share))}")
    if denied := figures["unavoidable"]:
        parts.append(f"the sky denied {percent(denied)} more")
    return "; ".join(parts)


def percent(value: float) -> str:
    """Return a share with as many decimals as it needs."""
    return f"{value:.3f} %" if 0.0 < value < 0.1 else f"{value:.2f} %"


def curve_lines(curve: Curve, can_draw: bool, width: int) -> Iterator[str]:
    """Draw available, dispatched and delivered power, one line each on one scale."""
    curves = {
        "available": np.array(curve.available_kw, float),  # NaN where one is unknown.
        "dispatch": np.array(curve.dispatch_kw, float),
        "delivered": np.array(curve.delivered_kw, float),
    }
    highest = max((kw for kws in curves.values() for kw in kws if isfinite(kw)), default=0.0)
    steps = min(len(curve.dispatch_kw), max(width - _BESIDE_CURVE, 10))
    for name, powers in curves.items():
        known = [kw for kw in powers if isfinite(kw)]
        span = f"{power(min(known))} to {power(max(known))}" if known else "unknown"
        drawn = sparkline(_fewer(powers, steps), highest, _BLOCKS if can_draw else _PLAIN_BLOCKS)
        yield f"{name:<9} {drawn}  {span}"


def sparkline(values: Sequence[float], highest: float, blocks: str) -> str:
    """Draw powers from 0 to the highest as one line of blocks; a blank where one is unknown."""
    last = len(blocks) - 1
    return "".join(
        blocks[min(round(value / highest * last), last)] if value >= 0.0 < highest else " "
        for value in values
    )


def _fewer(powers_kw: NDArray[np.float64], steps: int) -> list[float]:
    """Return the means of so many parts; NaN where a part has an unknown power."""
    return [float(part.mean()) for part in np.array_split(powers_kw, steps)] if steps else []


def minute_line(minute: HardMinute, start: pd.Timestamp, cycle_s: float) -> str:
    """Say when a hard minute was hardest, who lacked power and who gave it."""
    time = start + pd.Timedelta(seconds=minute.cycle * cycle_s)
    return f"{time:%H:%M:%S}: {minute.sentence()}"


def power(kw: float) -> str:
    """Return a power with the unit that suits its size."""
    if kw < 1_000.0:
        return f"{kw:,.0f} kW"
    return f"{kw / 1e3:,.2f} MW" if kw < 100_000.0 else f"{kw / 1e3:,.0f} MW"
