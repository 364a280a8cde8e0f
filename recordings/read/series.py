"""A run as arrays, one row a cycle: what metrics and figures are made from.

Wherever a run comes from (a recording, agents in memory, arrays), it becomes a `RunSeries`, so that
one code computes its figures of merit.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import nan
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from agents.events import PlantPower
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Dispatch, Message, Production
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, PRODUCTION, RESIDUAL, Port, Signal
from bus_schemas.tree import ROOT
from recordings.read.reader import RunReader

_OF_INVERTERS: Final[tuple[Signal[Message], ...]] = (IMPP, RESIDUAL, COMMAND)
"""Signals that the series keeps of each inverter."""


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
    ramp_limit_percent_per_min
        Ramp limit in % of the plant's rating per minute, if a grid code sets one.
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
    ramp_limit_percent_per_min: float | None = None

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
    def known(self) -> NDArray[np.bool_]:
        """Whether the recording has dispatch and production of each cycle, shape (T,)."""
        return np.isfinite(self.desired_kw) & np.isfinite(self.possible_kw + self.delivered_kw)

    @property
    def times(self) -> pd.DatetimeIndex:
        """Local time of the beginning of each cycle, length T."""
        first = pd.Timestamp(self.start_time_ns, tz="UTC").tz_convert(self.timezone)
        return pd.date_range(first, periods=self.cycles, freq=pd.Timedelta(seconds=self.cycle_s))


@dataclass(slots=True)
class _History:
    """What was said on one port: the cycle and the value of each message."""

    cycle: list[int] = field(default_factory=list)
    value: list[float] = field(default_factory=list)


class SeriesCollector:
    """Turns the messages of a run, live or from a recording, into a `RunSeries`.

    Parameters
    ----------
    plan
        Of the run.
    """

    def __init__(self, plan: RunPlan) -> None:
        self._plan = plan
        self._productions: list[Production] = []
        self._dispatches: dict[int, Dispatch] = {}
        self._of_inverters = {
            signal.of(leaf): _History() for signal in _OF_INVERTERS for leaf in plan.tree.leaves
        }

    def see(self, port: Port[Message], message: Message) -> None:
        """Take in a message; others than those of the series do not matter."""
        history = self._of_inverters.get(port)
        if history is not None:
            history.cycle.append(message.cycle)
            history.value.append(message.alpha if port.signal is COMMAND else message.power_kw)  # type: ignore[attr-defined]
        elif port.signal is PRODUCTION:
            self._productions.append(message)  # type: ignore[arg-type]
        elif isinstance(message, Dispatch):
            self._dispatches.setdefault(message.cycle, message)

    def series(self, label: str) -> RunSeries:
        """Return the cycles that are complete so far.

        Raises
        ------
        InputError
            No cycle is complete.
        """
        cycles = len(self._productions)
        if not cycles:
            raise InputError("the run has no complete cycle, accepted is one with at least one")
        tree = self._plan.tree
        dispatched = [message for cycle, message in self._dispatches.items() if 0 <= cycle < cycles]
        return RunSeries(
            label=label,
            inverters=tree.leaves,
            rating_kw=np.array([tree.rating_kw(leaf) for leaf in tree.leaves]),
            timezone=self._plan.timezone,
            start_time_ns=self._plan.start_time_ns,
            cycle_s=self._plan.cycle_ns / 1e9,
            commitment_kw=np.array([message.commitment_kw for message in dispatched]),
            regulation_kw=np.array([message.regulation_kw for message in dispatched]),
            regulation_capacity_kw=self._plan.regulation_capacity_kw,
            mpp_kw=np.array([message.inverter_mpp_kw for message in self._productions]),
            power_kw=np.array([message.inverter_power_kw for message in self._productions]),
            impp_kw=self._array(IMPP, cycles),
            residual_kw=self._array(RESIDUAL, cycles),
            alpha=self._array(COMMAND, cycles),
            ramp_limit_percent_per_min=self._plan.ramp_limit_percent_per_min,
        )

    def _array(self, signal: Signal[Message], cycles: int) -> NDArray[np.float64]:
        """Put what was said of each inverter into its cycle; NaN where nothing was."""
        leaves = self._plan.tree.leaves
        found = np.full((cycles, len(leaves)), nan)
        for place, leaf in enumerate(leaves):
            history = self._of_inverters[signal.of(leaf)]
            cycle, value = np.array(history.cycle, dtype=np.int64), np.array(history.value)
            kept = (cycle >= 0) & (cycle < cycles)
            # An external agent may say several things in a cycle: the first one stands here.
            found[cycle[kept][::-1], place] = value[kept][::-1]
        return found


def plant_series(plan: RunPlan, power: PlantPower) -> RunSeries:
    """Return a run of which only the plant's power is known, as if it were one inverter."""
    desired_kw, regulation_kw = np.array(power.desired_kw), np.array(power.regulation_kw)
    unknown = np.full((len(desired_kw), 1), nan)
    return RunSeries(
        label=plan.run_id,
        inverters=("plant",),
        rating_kw=np.array([plan.tree.rating_kw(ROOT)]),
        timezone=plan.timezone,
        start_time_ns=plan.start_time_ns,
        cycle_s=plan.cycle_ns / 1e9,
        commitment_kw=desired_kw - regulation_kw,
        regulation_kw=regulation_kw,
        regulation_capacity_kw=plan.regulation_capacity_kw,
        mpp_kw=np.array(power.possible_kw)[:, None],
        power_kw=np.array(power.delivered_kw)[:, None],
        impp_kw=unknown,
        residual_kw=unknown,
        alpha=unknown,
        ramp_limit_percent_per_min=plan.ramp_limit_percent_per_min,
    )


def read_series(path: Path) -> RunSeries:
    """Read a recording as a series.

    Parameters
    ----------
    path
        The MCAP file, or the folder of a run.

    Raises
    ------
    InputError
        There is no such recording, or no cycle of it is complete.
    """
    with RunReader(path) as reader:
        collector = SeriesCollector(reader.plan)
        for port, message in reader.messages(
            DISPATCH, IMPP, RESIDUAL, COMMAND, PRODUCTION, by_time=False
        ):
            collector.see(port, message)
        try:
            return collector.series(reader.plan.run_id)
        except InputError as error:
            raise InputError(f"{reader.path}: {error}") from None
