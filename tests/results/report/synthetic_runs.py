"""Runs as arrays for the tests of the report, without agents: clouds, a schedule, its outcome."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from plans_by_hand import plan_of

from recordings.read.series import RunSeries

INVERTERS = ("c1/inv01", "c2/inv02", "c1/inv03", "c2/inv04", "c1/inv05")
RATING_KW = 100.0
TEN_O_CLOCK_HST_NS = 1_270_152_000_000_000_000
"""2010-04-01T10:00:00-10:00."""


def cloudy_run(
    label: str = "hierarchical",
    cycles: int = 900,
    *,
    cycle_s: float = 1.0,
    regulation: bool = False,
    inverters: tuple[str, ...] = INVERTERS,
) -> RunSeries:
    """Return a run in which clouds pass from one inverter to the next; the plant shares by need."""
    n = len(inverters)
    seconds = np.arange(cycles) * cycle_s
    phase = 2.0 * np.pi * (seconds[:, None] / 300.0 - np.arange(n) / n)
    mpp_kw = RATING_KW * (0.25 + 0.65 / (1.0 + np.exp(-8.0 * (np.cos(phase) + 0.4))))
    commitment_kw = np.full(cycles, 0.5 * RATING_KW * n)
    signal = np.sin(2.0 * np.pi * seconds / 40.0) if regulation else np.zeros(cycles)
    capacity_kw = 50.0 if regulation else 0.0
    dispatch_kw = commitment_kw + capacity_kw * signal
    # Each inverter believes what it could do in the cycle before.
    impp_kw = np.vstack([mpp_kw[:1], mpp_kw[:-1]])
    share_kw = dispatch_kw[:, None] / n
    met_kw = np.minimum(share_kw, impp_kw)
    room_kw = impp_kw - met_kw
    missing_kw = (dispatch_kw - met_kw.sum(axis=1))[:, None]
    share = np.minimum(missing_kw / np.maximum(room_kw.sum(axis=1)[:, None], 1e-9), 1.0)
    alpha = (met_kw + share * room_kw) / impp_kw
    plan = plan_of(
        dict.fromkeys(inverters, RATING_KW),
        start_time_ns=TEN_O_CLOCK_HST_NS,
        timezone="Pacific/Honolulu",
        cycle_ns=round(cycle_s * 1e9),
        cycles=cycles,
        regulation_capacity_kw=capacity_kw,
    )
    values = {
        "commitment_kw": commitment_kw,
        "regulation_kw": capacity_kw * signal,
        "mpp_kw": mpp_kw,
        "power_kw": alpha * mpp_kw,
        "impp_kw": impp_kw,
        "residual_kw": impp_kw - share_kw,
        "alpha": alpha,
    }
    return RunSeries.of(plan, label, values)


def without_estimates(run: RunSeries, label: str) -> RunSeries:
    """Return a run of a scheme that estimates nothing: each inverter at its share, no help."""
    n = len(run.inverters)
    power_kw = np.minimum(run.mpp_kw, run.dispatch_kw[:, None] / n)
    nothing = np.full_like(power_kw, np.nan)
    return replace(
        run,
        label=label,
        power_kw=power_kw,
        impp_kw=nothing,
        residual_kw=nothing,
        alpha=np.divide(power_kw, run.mpp_kw, out=np.ones_like(power_kw), where=run.mpp_kw > 0.0),
    )
