"""Runs of a plant of two inverters of 500 kW, written down power by power."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from recordings.read.series import RunSeries, SeriesPlant

RATING_KW = 1000.0

NOON = "2010-04-01T12:00:00"


def run_of(
    commitment_kw: ArrayLike,
    available_kw: ArrayLike,
    delivered_kw: ArrayLike,
    *,
    regulation_kw: ArrayLike = 0.0,
    capacity_kw: float = 0.0,
    cycle_s: float = 1.0,
    start: str = NOON,
) -> RunSeries:
    """Return a run, its power in halves on two inverters, that starts at a local time on Oahu."""
    commitment = np.asarray(commitment_kw, dtype=float)
    regulation = np.broadcast_to(np.asarray(regulation_kw, dtype=float), commitment.shape)
    mpp_kw = np.outer(np.broadcast_to(available_kw, commitment.shape), [0.5, 0.5])
    power_kw = np.outer(np.broadcast_to(delivered_kw, commitment.shape), [0.5, 0.5])
    utc = np.datetime64(start, "ns") + np.timedelta64(10, "h")
    return RunSeries(
        label="by hand",
        plant=SeriesPlant(
            inverters=("c1/a", "c1/b"),
            rating_kw=np.array([500.0, 500.0]),
            timezone="Pacific/Honolulu",
            start_time_ns=int(utc.astype(np.int64)),
            cycle_s=cycle_s,
            regulation_capacity_kw=capacity_kw,
        ),
        commitment_kw=commitment,
        regulation_kw=regulation,
        dispatch_kw=commitment + regulation,
        mpp_kw=mpp_kw,
        power_kw=power_kw,
        impp_kw=mpp_kw,
        residual_kw=np.full_like(mpp_kw, np.nan),
        alpha=np.ones_like(mpp_kw),
        unknown_kw=np.zeros_like(commitment),
        unlisted_kw=np.zeros_like(commitment),
        frequency_hz=np.full_like(commitment, np.nan),
        desired_kw=commitment + regulation,
        response_kw=np.zeros_like(commitment),
    )


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
