"""A run as arrays, one row a cycle: what metrics and figures are made from.

Wherever a run comes from (a recording, agents in memory, arrays), it becomes a `RunSeries`, so that
one code computes its figures of merit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class RunSeries:
    """T cycles of a plant of n inverters under one control scheme. All powers in kW.

    Attributes
    ----------
    label
        What to call it in a table or a legend, for instance the control scheme.
    inverters
        Paths of the inverters in the control tree (`c1/inv07`), n of them.
    rating_kw
        AC rating of each inverter, shape (n,).
    timezone
        Local time of the plant, an IANA name.
    start_time_ns
        Simulated time of the first cycle, ns since 1970-01-01 UTC.
    cycle_s
        Length of a cycle [s].
    commitment_kw, regulation_kw
        What the operator wanted in each cycle, shape (T,): the power promised, and the regulation
        on top of it (0 throughout if there is none).
    regulation_capacity_kw
        Power that a regulation signal of +1 stands for; 0 if there is no regulation.
    mpp_kw
        True maximum power of each inverter, shape (T, n).
    power_kw
        Power that each inverter delivered, shape (T, n).
    impp_kw
        Maximum power that the controllers believed each inverter had when they decided, shape
        (T, n). NaN where a scheme estimates none.
    residual_kw
        IMPP less request, shape (T, n); NaN where a scheme has none.
    alpha
        Curtailment level in [0, 1] that each inverter applied, shape (T, n).
    """

    label: str
    inverters: tuple[str, ...]
    rating_kw: NDArray[np.float64]
    timezone: str
    start_time_ns: int
    cycle_s: float
    commitment_kw: NDArray[np.float64]
    regulation_kw: NDArray[np.float64]
    regulation_capacity_kw: float
    mpp_kw: NDArray[np.float64]
    power_kw: NDArray[np.float64]
    impp_kw: NDArray[np.float64]
    residual_kw: NDArray[np.float64]
    alpha: NDArray[np.float64]

    @property
    def cycles(self) -> int:
        """Number of cycles, T."""
        return len(self.mpp_kw)

    @property
    def desired_kw(self) -> NDArray[np.float64]:
        """Commitment plus regulation, the paper's P_desired, shape (T,)."""
        return self.commitment_kw + self.regulation_kw

    @property
    def possible_kw(self) -> NDArray[np.float64]:
        """True maximum power of the plant, shape (T,)."""
        return np.asarray(self.mpp_kw.sum(axis=1))

    @property
    def delivered_kw(self) -> NDArray[np.float64]:
        """Power of the plant, shape (T,)."""
        return np.asarray(self.power_kw.sum(axis=1))

    @property
    def support_kw(self) -> NDArray[np.float64]:
        """Power that others had to give, max(0, P_desired - P), shape (T,)."""
        return np.maximum(self.desired_kw - self.delivered_kw, 0.0)

    @property
    def times(self) -> pd.DatetimeIndex:
        """Local time of the beginning of each cycle, length T."""
        first = pd.Timestamp(self.start_time_ns, tz="UTC").tz_convert(self.timezone)
        return pd.date_range(first, periods=self.cycles, freq=pd.Timedelta(seconds=self.cycle_s))
