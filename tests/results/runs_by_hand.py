"""Runs of a plant of two inverters of 500 kW, written down power by power."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from plans_by_hand import plan_of, with_changes

from recordings.read.series import RunSeries

RATING_KW = 1000.0

NOON = "2010-04-01T12:00:00"
_PLANT = plan_of({"c1/a": 500.0, "c1/b": 500.0}, timezone="Pacific/Honolulu")


def run_of(
    commitment_kw: ArrayLike,
    available_kw: ArrayLike,
    delivered_kw: ArrayLike,
    *,
    regulation_kw: ArrayLike = 0.0,
    capacity_kw: float = 0.0,
    cycle_s: float = 1.0,
    start: str = NOON,
    **changes: object,
) -> RunSeries:
    """Return a run, its power in halves on two inverters, that starts at a local time on Oahu.

    `changes` are those of its plan.
    """
    commitment = np.asarray(commitment_kw, dtype=float)
    utc = np.datetime64(start, "ns") + np.timedelta64(10, "h")
    of_plan = {
        "start_time_ns": int(utc.astype(np.int64)),
        "cycle_ns": round(cycle_s * 1e9),
        "cycles": len(commitment),
        "regulation_capacity_kw": capacity_kw,
    }
    values = {
        "commitment_kw": commitment,
        "regulation_kw": np.broadcast_to(np.asarray(regulation_kw, dtype=float), commitment.shape),
        "mpp_kw": np.outer(np.broadcast_to(available_kw, commitment.shape), [0.5, 0.5]),
        "power_kw": np.outer(np.broadcast_to(delivered_kw, commitment.shape), [0.5, 0.5]),
    }
    return RunSeries.of(with_changes(_PLANT, **(of_plan | changes)), "by hand", values)


def sine_of_an_hour(response: float = 1.0) -> RunSeries:
    """Return an hour under a regulation signal, of which a share is given."""
    signal_kw = 200.0 * np.sin(np.arange(3600) / 40.0 + 0.1)
    return run_of(
        np.full(3600, 400.0),
        900.0,
        400.0 + response * signal_kw,
        regulation_kw=signal_kw,
        capacity_kw=200.0,
    )
